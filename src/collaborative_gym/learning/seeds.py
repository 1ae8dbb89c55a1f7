"""Seeds of the episodes that a run plays, apart from those that people use."""

from collaborative_gym.rng import check_seed

_TRAINING, _VALIDATION = 1 << 40, 1 << 41
"""Added to a run's seed. So no policy is trained on the episodes by which it is chosen,
and neither are those that `evaluate` plays for a seed that people use."""


def training_seed(seed: int) -> int:
    """Return the seed of a run's training episodes."""
    return _TRAINING + check_run_seed(seed)


def validation_seed(seed: int) -> int:
    """Return the seed of a run's validation episodes."""
    return _VALIDATION + check_run_seed(seed)


def check_run_seed(seed: int) -> int:
    """Return a run's seed, checked as `check_seed` does and to be below 2**40."""
    number = check_seed(seed)
    if number >= _TRAINING:
        raise ValueError(f"a training seed must be below 2**40, got {number}")
    return number
