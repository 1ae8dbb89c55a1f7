"""What the tests of environments compare."""

import numpy as np
import pytest


@pytest.fixture
def assert_same():
    """Return a function that fails unless two states are the same to the bit."""

    def assert_same(state, other):
        np.testing.assert_array_equal(state.physics, other.physics)
        for part in ("memory", "progress"):
            for name, array in getattr(state, part).items():
                np.testing.assert_array_equal(array, getattr(other, part)[name])

    return assert_same
