"""The tasks and the environment ids made of them."""

# The order of the thesis, and so of every list and table.
# isort: off
from collaborative_gym.tasks import poke
from collaborative_gym.tasks import lift
from collaborative_gym.tasks import balance
from collaborative_gym.tasks import pass_

__all__ = ["balance", "lift", "pass_", "poke"]
