"""What a bad input must meet with: a sentence of ours, and a world as it was."""

import io
import re
import signal
import traceback
from collections.abc import Callable, Iterable
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import collaborative_gym as cg
from collaborative_gym.cli.main import main

PACKAGE = Path(cg.__file__).parent

KINDS = (
    TypeError,
    ValueError,
    LookupError,
    OSError,
    RuntimeError,
    ImportError,
)
"""The documented errors; KeyError and IndexError are LookupErrors."""

TIME = 30.0
"""Seconds after which a call counts as hung."""

Call = Callable[[Any, Any], object]


@dataclass(frozen=True)
class Case:
    """A call that must fail.

    Attributes:
      group: what is called.
      argument: what the value is given for; the message must name it, or the value.
      given: the bad value.
      call: does it, with what the cases share and the value.
    """

    group: str
    argument: str
    given: Any
    call: Call

    @property
    def name(self) -> str:
        """Its name as a test."""
        # Without addresses: each process collects the same names.
        words = re.sub(" at 0x[0-9a-f]+", "", repr(self.given))
        words = " ".join(words.split())[:40]
        return f"{self.group}: {self.argument}={words}"


class Accepted(Exception):
    """A bad value was taken; raised so that nothing long is begun."""


class _HungError(BaseException):
    """A call took too long."""


def table(group: str, argument: str, call: Call, *values: Iterable) -> list[Case]:
    """Return a case for each value of the lists."""
    return [Case(group, argument, given, call) for some in values for given in some]


def accepted(*_: object) -> None:
    """Stand for a callback that is called only once all inputs were taken."""
    raise Accepted


def fault(case: Case, shared: Any) -> str:
    """Return what is wrong about what comes of a bad input, or nothing."""
    before = shared.snapshot()
    try:
        with _time_limit():
            case.call(shared, case.given)
    except Accepted:
        return "it is accepted"
    except _HungError:
        return "it hangs"
    except Exception as error:
        found = _unclear(case, error)
    else:
        return "it is accepted"
    return found or ("" if same(before, shared.snapshot()) else "a world changed")


def command_fault(arguments: list[str], status: int, mentions: tuple[str, ...]) -> str:
    """Return what is wrong about what a command says of bad input, or nothing."""
    out, err = io.StringIO(), io.StringIO()
    try:
        with _time_limit(), redirect_stdout(out), redirect_stderr(err):
            ended = main(arguments)
    except SystemExit as end:
        ended = end.code
    except _HungError:
        return "it hangs"
    except Exception as error:
        return f"it raises {error!r}"
    words = err.getvalue()
    if ended != status:
        return f"its status is {ended}, not {status}: {words}"
    if "Traceback" in words or len(words.split()) < 4:
        return f"it is no sentence: {words}"
    flat = " ".join(words.replace("│", " ").replace("_", "-").split())
    if not any(hint and hint.replace("_", "-") in flat for hint in mentions):
        return f"it mentions none of {mentions}: {words}"
    return ""


def same(one: Any, other: Any) -> bool:
    """Return whether two snapshots are equal to the bit."""
    if isinstance(one, dict):
        return all(same(one[name], other[name]) for name in one)
    return one is other or np.array_equal(one, other, equal_nan=True)


def _unclear(case: Case, error: Exception) -> str:
    """Return what is wrong about an error, or nothing if it is a sentence of ours."""
    if "was raised from the environment creator" in str(error):
        return ""  # Gymnasium raises it again, with more words than ours.
    words, last = str(error), traceback.extract_tb(error.__traceback__)[-1]
    told = f"{type(error).__name__}: {words}"
    if not isinstance(error, KINDS):
        return f"not one of the documented errors: {told}"
    line = last.line or ""
    if PACKAGE not in Path(last.filename).parents or not line.startswith("raise"):
        return f"a library's own words: {told}"
    if len(words.split()) < 4:
        return f"no sentence: {told}"
    hints = case.argument, repr(case.given)[:12], str(case.given)[:12]
    if not any(hint and hint.lower() in words.lower() for hint in hints):
        return f"it names neither {case.argument} nor what was given: {told}"
    return ""


@contextmanager
def _time_limit():
    def end(*_: object) -> None:
        raise _HungError

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, TIME)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
