"""Errors that tell the caller what was given, what is allowed and what to do."""

import difflib
from collections.abc import Iterable
from numbers import Integral


class SimulationDiverged(RuntimeError):
    """Physics produced a state that is not finite.

    Attributes:
      env_ids: the worlds that diverged.
    """

    def __init__(self, env_ids: Iterable[int]):
        self.env_ids = tuple(int(i) for i in env_ids)
        super().__init__(f"physics diverged in worlds {self.env_ids}")


class UnknownName(KeyError):
    """A name that names nothing. Unlike `KeyError`, it prints its message as it is."""

    def __str__(self) -> str:
        return str(self.args[0])


def unknown(kind: str, given: object, valid: Iterable[str]) -> str:
    """Return the message for a name that is none of the valid ones.

    Args:
      kind: what the name should have named, such as "robot".
      given: the name as the caller gave it.
      valid: every name that would have been accepted.

    Returns:
      One sentence that lists the valid names and suggests the nearest.
    """
    names = sorted(valid)
    lower = {name.lower(): name for name in names}
    near = difflib.get_close_matches(str(given).lower(), lower, n=1, cutoff=0.5)
    hint = f" (did you mean {lower[near[0]]!r}?)" if near else ""
    kinds = f"{kind[:-1]}ies" if kind.endswith("y") else f"{kind}s"
    return f"no {kind} {given!r}; {kinds}: {', '.join(names)}{hint}"


def check_count(name: str, given: int, at_least: int) -> None:
    """Raise unless a number is an integer and not too small.

    Raises:
      TypeError: if it is no integer.
      ValueError: if it is below the least.
    """
    if isinstance(given, bool) or not isinstance(given, Integral):
        raise TypeError(f"{name} must be an integer, got {given!r}")
    if given < at_least:
        raise ValueError(f"{name} must be at least {at_least}, got {given}")
