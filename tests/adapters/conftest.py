"""What the tests of adapters play."""

import pytest


@pytest.fixture
def short(carry):
    """Return the small task with episodes that are over when the cube is up."""

    class Short(type(carry())):
        def over(self, facts):
            return super().success(facts)

    task = carry()
    return Short(list(task.robots.values()), task.config)
