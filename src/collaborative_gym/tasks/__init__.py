"""The tasks and the environment ids made of them."""

# The order of the thesis, and so of every list and table; then our own.
# isort: off
from collaborative_gym.tasks import poke
from collaborative_gym.tasks import lift
from collaborative_gym.tasks import balance
from collaborative_gym.tasks import pass_
from collaborative_gym.tasks import balance_path
from collaborative_gym.tasks import hockey
from collaborative_gym.tasks import tug
from collaborative_gym.tasks import reach
from collaborative_gym.tasks import sort
from collaborative_gym.tasks import assemble

__all__ = [
    "assemble",
    "balance",
    "balance_path",
    "hockey",
    "lift",
    "pass_",
    "poke",
    "reach",
    "sort",
    "tug",
]
