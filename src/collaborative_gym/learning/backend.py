"""What the training loop drives: something that collects and learns."""

from dataclasses import dataclass
from typing import Any, Protocol

from collaborative_gym.policies.network import Weights
from collaborative_gym.rng import check_seed

_TRAINING, _VALIDATION = 1 << 40, 1 << 41
"""Added to a run's seed. So no policy is trained on the episodes by which it is chosen,
and neither are those that `evaluate` plays for a seed that people use."""


@dataclass(frozen=True)
class Iteration:
    """What one rollout and one update brought.

    Attributes:
      episodes: a row for each episode that ended and was played in full, as
        `evaluation.episode_row` gives it.
      numbers: of the update, by learner: `policy_loss`, `value_loss`, `entropy_loss`,
        `std` (of the actions), `kl` (divergence of the last epoch), `learning_rate` and
        `weight_norm`.
    """

    episodes: list[dict[str, Any]]
    numbers: dict[str, dict[str, float]]


class Backend(Protocol):
    """Collects from worlds of one task and learns.

    Attributes:
      steps: environment steps done so far, over all worlds.
    """

    steps: int

    def advance(self) -> Iteration:
        """Collect one rollout in every world, and learn from it."""
        ...

    def weights(self) -> dict[str, Weights]:
        """Return what the networks have learned so far, by name."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Return all that is needed to go on: tensors, numbers and texts, nested."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned."""
        ...

    def close(self) -> None:
        """Free what it holds. No other call is allowed afterwards."""
        ...


def training_seed(seed: int) -> int:
    """Return the seed of a run's training episodes."""
    return _TRAINING + _checked(seed)


def validation_seed(seed: int) -> int:
    """Return the seed of a run's validation episodes."""
    return _VALIDATION + _checked(seed)


def _checked(seed: int) -> int:
    if check_seed(seed) >= _TRAINING:
        raise ValueError(f"a training seed must be below 2**40, got {seed}")
    return seed
