"""Numbers that a setting may have."""

from dataclasses import field, fields, replace
from typing import Any

import numpy as np

from collaborative_gym.errors import check_count, check_flag, check_number


def bounded(default: float | None, at_least: float, at_most: float) -> Any:
    """Return a field of settings: a number in bounds, or None if it is None."""
    return field(default=default, metadata={"at_least": at_least, "at_most": at_most})


def filled(settings: Any, **usual: Any) -> Any:
    """Return settings with the usual value of each of these that is None."""
    missing = {n: own for n, own in usual.items() if getattr(settings, n) is None}
    return replace(settings, **missing)


def check_settings(settings: Any) -> None:
    """Check the fields that are numbers or booleans, and make them Python's.

    Raises:
      TypeError: if one is of another kind than its default.
      ValueError: if one is not finite, or out of the bounds that it has by `bounded`.
    """
    for option in fields(settings):
        name, kind = option.name, type(option.default)
        if option.type in (int, float, bool) and option.default is not None:
            kind = option.type
        given = getattr(settings, name)
        if kind is int:
            number = check_count(
                name, given, **(option.metadata or {"at_least": -(2**63)})
            )
        elif kind is float or (option.metadata and given is not None):
            number = check_number(name, given, **option.metadata)
        elif kind is bool or (option.type == bool | None and given is not None):
            number = check_flag(name, given)
        else:
            continue
        if isinstance(given, np.generic) or not isinstance(given, type(number)):
            object.__setattr__(settings, name, number)
