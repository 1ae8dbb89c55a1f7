"""Errors that say what was given, what is allowed and what to do."""

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import groupby
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

MOST_ENVS = 10**6
"""More worlds than fit into any machine."""

MOST_THREADS = 1024
"""More threads than any machine runs well."""

_LISTED = 16
"""Most names in an error; of more it lists those that are near, eight at most."""

_REMEDIES = {
    "mass and inertia of moving bodies": "give it a mass in kg and an inertia in kg m2",
    "A + B >= C": "no body has this inertia: give it in kg m2, about the mass's centre",
    "opening file": "put the mesh beside the model file, or where its meshdir says",
    "truth value of an array": "rows are worlds; use np.where or a mask",
    "be broadcast": "rows are worlds; index one number for each as [:, None]",
    "'EpisodeRandom'": "draw by rng.uniform(low, high, k) or rng.within(bound, k)",
    "read-only": "put a new array into sim.memory instead",
}
"""Remedies of frequent faults, by a part of MuJoCo's or NumPy's words."""

_NO_NUMBERS = bool, np.timedelta64  # python and NumPy count these as integers


class SimulationDiverged(RuntimeError):
    """Physics produced a state that is not finite.

    Attributes:
      env_ids: the worlds that diverged.
    """

    def __init__(self, env_ids: Iterable[int]):
        self.env_ids = tuple(int(i) for i in env_ids)
        super().__init__(f"physics diverged in worlds {self.env_ids}")


class UnknownName(KeyError):
    """A name that does not exist. Unlike `KeyError`, it prints its message as it is."""

    def __str__(self) -> str:
        return str(self.args[0])


class UnknownOption(UnknownName, TypeError):
    """A keyword argument that does not exist. The message is like Python's own."""


def how_to_install(extra: str) -> str:
    """Return the command that installs an extra of this package, in a clone of it.

    What PyPI calls `collaborative-gym` is another project. Without the constraints, pip
    may take versions that were not tried, and a torch of several gigabytes.
    """
    return f"pip install --constraint constraints.txt --editable '.[{extra}]'"


@contextmanager
def naming(what: str) -> Iterator[None]:
    """Begin the message of an error within with the input, such as "player 'late'".

    The error keeps its class, unless that takes more than a message, as for text that
    cannot be decoded; then it is the nearest one of the classes below.

    Raises:
      FileNotFoundError, LookupError, TypeError, ValueError: what was raised within.
    """
    kinds = FileNotFoundError, LookupError, TypeError, ValueError
    try:
        yield
    except kinds as error:
        message = f"{what}: {error}"
        try:
            named = type(error)(message)
        except TypeError:
            named = next(kind for kind in kinds if isinstance(error, kind))(message)
        raise named from error


def unknown(kind: str, given: object, valid: Iterable[str]) -> str:
    """Return the message for a name that is not one of the valid ones.

    It suggests the nearest name and lists all of them, or the nearest ones of many.

    Args:
      kind: of the name, such as "robot".
      given: the name, as the caller gave it.
      valid: all names that exist.
    """
    names = sorted(valid)
    lower = {name.lower(): name for name in names}
    asked = str(given).lower()
    near = difflib.get_close_matches(asked, lower, n=1)
    near = near or [name for name in lower if asked and name.startswith(asked)]
    # Before the list, which may be long.
    hint = f" (did you mean {lower[near[0]]!r}?)" if near else ""
    kinds = f"{kind[:-1]}ies" if kind.endswith("y") else f"{kind}s"
    if len(names) > _LISTED:
        close = difflib.get_close_matches(asked, lower, 8) or sorted(lower)[:8]
        left = f"and {len(names) - len(close)} others"
        names = [*sorted(lower[name] for name in close), left]
    return f"no {kind} {shown(given)}{hint}; {kinds}: {', '.join(names) or 'none'}"


def counted(names: Iterable[str]) -> str:
    """Return names as a list, with a number for several of one kind in a row."""
    runs = [(name, len(list(own))) for name, own in groupby(names)]
    return ", ".join(name if count == 1 else f"{count} {name}" for name, count in runs)


def told_by_mujoco(error: ValueError) -> str:
    """Return MuJoCo's complaint about a model, on one line, and a remedy."""
    lines = re.sub("(XML )?Error: ", "", str(error)).splitlines()
    return with_remedy(", ".join(line.strip() for line in lines if line.strip()))


def with_remedy(text: str) -> str:
    """Return another library's words, with the remedy of a frequent fault."""
    remedy = next((do for part, do in _REMEDIES.items() if part in text), "")
    return f"{text.rstrip('.')}; {remedy}" if remedy else text


def look_up(kind: str, given: object, table: Mapping[str, T]) -> T:
    """Return the entry of a table by its name, which may be of whatever type.

    Raises:
      KeyError: if there is no such `kind` of thing, such as "robot".
    """
    if isinstance(given, str) and given in table:
        return table[given]
    raise UnknownName(unknown(kind, given, table))


def look_up_registered(kind: str, given: object, table: Mapping[str, T]) -> T:
    """Return as `look_up` an entry of a table to which users can add.

    Raises:
      KeyError: if there is none; says how to name the file that registers it.
    """
    try:
        return look_up(kind, given, table)
    except UnknownName as error:
        # Whoever resumes the training of an own task easily forgets its file.
        how = " (`collaborative-gym list` shows all)" if len(table) > _LISTED else ""
        raise UnknownName(
            f"{error}{how}; for one of your own, load its file (--module FILE,"
            " cg.load_module)"
        ) from None


def shown(given: object) -> str:
    """Return an input as an error shows it, on one line that is not too long."""
    words = " ".join(repr(given).split())
    return words if len(words) <= 80 else f"{words[:77]}..."


def check_count(
    name: str, given: Any, at_least: int = 0, at_most: float = 2**63 - 1
) -> int:
    """Return an integer within bounds as an `int`.

    Raises:
      TypeError: if it is not an integer; a bool is not one.
      ValueError: if it is out of bounds.
    """
    if isinstance(given, _NO_NUMBERS) or not isinstance(given, Integral):
        raise TypeError(f"{name} must be an integer, got {shown(given)}")
    number = int(given)
    if number < at_least:
        raise ValueError(f"{name} must be at least {at_least}, got {number}")
    if number > at_most:
        raise ValueError(f"{name} must be at most {at_most}, got {number}")
    return number


def check_number(
    name: str,
    given: Any,
    *,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    above: float = -math.inf,
) -> float:
    """Return a number that must be real, finite and within bounds, as a float.

    Raises:
      TypeError: if it is not a real number; a bool is not one.
      ValueError: if it is not finite or out of bounds.
    """
    if isinstance(given, _NO_NUMBERS) or not isinstance(given, Real):
        raise TypeError(f"{name} must be a number, got {shown(given)}")
    try:
        number = float(given)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} must be finite, got {shown(given)}")
    if number <= above:
        raise ValueError(f"{name} must be above {above:g}, got {shown(given)}")
    if not at_least <= number <= at_most:
        bounds = f"at least {at_least:g}"
        if at_most < math.inf:
            bounds = f"{at_least:g} to {at_most:g}".replace("-inf to", "at most")
        raise ValueError(f"{name} must be {bounds}, got {shown(given)}")
    return number


def check_numbers(name: str, given: Any, count: int | None = None) -> tuple[float, ...]:
    """Return `count` numbers, or any number of them, each checked by `check_number`.

    Raises:
      TypeError: if it is not a sequence or array of numbers.
      ValueError: if there are fewer or more, or one is not finite.
    """
    wanted = "a sequence of numbers" if count is None else f"{count} numbers"
    if isinstance(given, str | bytes) or not isinstance(given, Sequence | np.ndarray):
        raise TypeError(f"{name} must be {wanted}, got {shown(given)}")
    if count not in (None, len(given)):
        raise ValueError(f"{name} must be {wanted}, got {shown(given)}")
    return tuple(check_number(f"{name}[{i}]", each) for i, each in enumerate(given))


def check_name(name: str, given: Any) -> None:
    """Raise unless an input is a text that is not empty."""
    check_kind(name, given, str, "a string")
    if not given:
        raise ValueError(f"{name} must not be empty, got ''")


def check_word(name: str, given: Any) -> None:
    """Raise unless an input is a word that commands, links and files can name."""
    check_name(name, given)
    if not re.fullmatch(r"[\w:.-]+", given):
        raise ValueError(
            f"{name} must be one word of letters, digits and _ . : - , got {given!r}"
        )


def check_flag(name: str, given: Any) -> bool:
    """Return True or False; raise TypeError for anything else."""
    if not isinstance(given, bool | np.bool_):
        raise TypeError(f"{name} must be True or False, got {shown(given)}")
    return bool(given)


def check_callback(name: str, given: Any) -> None:
    """Raise TypeError unless an input can be called, or is None."""
    if given is not None and not callable(given):
        raise TypeError(f"{name} must be a function or None, got {shown(given)}")


def check_kind(name: str, given: Any, kinds: type | tuple[type, ...], a: str) -> None:
    """Raise TypeError unless an input is of a kind, such as `a` "string"."""
    if not isinstance(given, kinds):
        raise TypeError(f"{name} must be {a}, got {shown(given)}")
