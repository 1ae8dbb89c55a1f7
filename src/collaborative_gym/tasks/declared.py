"""Checks of what a task's class declares, before anything is made of it."""

import difflib
import inspect
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, get_args

from collaborative_gym.errors import check_count, check_flag, check_kind, shown
from collaborative_gym.tasks.task import Kept, Randomization, Task, TaskConfig

_CALLED = {"varied", "start", "start_arms", "chains", "joints", "share_idle"}
"""What a task calls and does not replace; near names are its own helpers."""

_NEEDED = {"build", "reset", "measure", "observe", "reward", "success"}
"""Methods that a task must have; it says itself if one is missing."""

_NEAR = 0.8  # likeness, by difflib's measure, from which a name is a slip; our choice


def check_class(task: Any) -> None:
    """Raise unless a class can be a task's; the error says where it is wrong.

    Raises:
      TypeError: if it is no task, or has a misspelt name, a setting, a method that
        cannot be called as `Task` says, or an attribute of another kind.
      ValueError: if a number is out of bounds.
    """
    if not (isinstance(task, type) and issubclass(task, Task)):
        raise TypeError(f"task must be a subclass of Task, got {shown(task)}")
    kind = task.config_class
    # Without a decorator of its own, it would have the fields of its base alone.
    is_config = isinstance(kind, type) and issubclass(kind, TaskConfig)
    if not is_config or "__dataclass_params__" not in vars(kind):
        raise TypeError(
            f"{task.__name__}.config_class must be a dataclass derived from TaskConfig,"
            f" with @dataclass(frozen=True) above it, got {shown(kind)}"
        )
    named = {each.name for each in fields(kind)}
    for name, value in vars(kind).items():
        if not (name[0] == "_" or name in named or hasattr(value, "__get__")):
            raise TypeError(
                f"{kind.__name__}.{name} is no setting without a type; write"
                f" {name}: {type(value).__name__} = {shown(value)}"
            )
    settings = named - vars(Task).keys()
    for base in task.__mro__[: task.__mro__.index(Task)]:
        for name in vars(base):
            if fault := _fault(task, base, name, settings):
                where = _place(task, name)
                raise TypeError(f"{task.__name__}.{name} {fault}{where}")
    _check_kinds(task, ["robot_counts", "randomizations"])


def check_attributes(task: Task) -> None:
    """Raise TypeError or ValueError if an attribute of a task is of another kind."""
    _check_kinds(task, _KINDS)
    kind, name, kept = type(task), task.progress_name, task.coordination
    if name is not None and name not in kept:
        raise ValueError(
            f"{kind.__name__}.progress_name is {shown(name)}, which is not in its"
            f" coordination: {', '.join(kept) or 'none'}{_place(kind, 'progress_name')}"
        )
    if task.styles and kind.styled is Task.styled:
        raise ValueError(f"{kind.__name__} has styles, but no styled(); write one")


def _fault(task: type[Task], base: type, name: str, settings: set[str]) -> str:
    """Return what is wrong with a name of a task's base, or nothing."""
    value, own = vars(base)[name], vars(Task).get(name)
    known = {n for n in [*vars(Task), *Task.__annotations__] if n[0] != "_"}
    is_method = inspect.isfunction(value)
    if inspect.isfunction(own):
        said = "" if callable(value) else f"must be a method, got {shown(value)}"
        return _misfit(value, own) if is_method else said
    if name in known:
        is_called = is_method and not inspect.isfunction(own)
        return "is a method; write @property above it" if is_called else ""
    if name in settings:
        said = "is a setting; make it a field of config_class, with its type"
        return "" if hasattr(value, "__get__") else said
    missing = {n for n in _NEEDED if getattr(task, n) is getattr(Task, n)}
    possible = known - _CALLED - missing - vars(base).keys() | vars(TaskConfig).keys()
    near = difflib.get_close_matches(name, possible, 1, _NEAR)
    if name[0] == "_" or not near or near[0][0] != name[0]:
        return ""
    return f"is no name of Task; write {near[0]}, or _{name} for a thing of your own"


def _misfit(value: Any, own: Any) -> str:
    """Return how a method differs from what it is called with, or nothing."""
    given, wanted = inspect.signature(value), inspect.signature(own).parameters
    named = [name for name, each in wanted.items() if each.kind is each.KEYWORD_ONLY]
    first = [name for name in wanted if name not in named]
    try:
        given.bind(*first, **dict.fromkeys(named))
    except TypeError:
        called = ", ".join([*first, *["*"][: len(named)], *named])
        return f"has the arguments {given}, but is called with ({called})"
    return ""


def _place(kind: type[Task], name: str) -> str:
    """Return the file and line at which a task's class has a name, if known."""
    base = next(each for each in kind.__mro__ if name in vars(each))
    try:
        lines, first = inspect.getsourcelines(base)
    except (OSError, TypeError):
        return ""
    is_here = re.compile(rf"\s+(def )?{name}\s*[(:=]").match
    file = Path(inspect.getfile(base)).name
    at = (f" ({file}, line {first + i})" for i, x in enumerate(lines) if is_here(x))
    return next(at, "")


def _check_kinds(task: Task | type[Task], names: Iterable[str]) -> None:
    kind = task if isinstance(task, type) else type(task)
    for name in names:
        try:
            _KINDS[name](f"{kind.__name__}.{name}", getattr(task, name))
        except (TypeError, ValueError) as error:
            raise type(error)(f"{error}{_place(kind, name)}") from None


def _check_counts(name: str, given: Any) -> None:
    check_kind(name, given, (tuple, list, range), "counts of robots, such as (2,)")
    for count in given or (0,):
        check_count(f"each of {name}", count, 1)


def _check_entries(name: str, given: Any, kind: type = str, words: Any = ()) -> None:
    a = f"a dictionary of a {kind.__name__} for each name"
    check_kind(name, given, Mapping, a)
    if kind is Randomization and "default" not in given:
        raise ValueError(f"{name} has no 'default'; add one")
    for key, value in given.items():
        if not isinstance(key, str) or not isinstance(value, kind):
            raise TypeError(f"{name} must be {a}, got {shown({key: value})}")
        if words and value not in words:
            raise ValueError(f"{name}[{key!r}] must be one of {words}, got {value!r}")


_KINDS = {
    "robot_counts": _check_counts,
    "randomizations": partial(_check_entries, kind=Randomization),
    "coordination": partial(_check_entries, words=get_args(Kept)),
    "success_for": partial(check_count, at_least=1),
    "success_after": check_count,
    **dict.fromkeys(("gripping", "performance_from_start"), check_flag),
    **dict.fromkeys(("styles", "units", "block_units"), _check_entries),
}
"""What checks an attribute, by its name."""
