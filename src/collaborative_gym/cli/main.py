"""The command line."""

import functools
import operator
import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from difflib import get_close_matches
from importlib.metadata import version
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from collaborative_gym.cli import commands
from collaborative_gym.cli.help import finished, owners
from collaborative_gym.cli.studies import Compare, Report, Tournament
from collaborative_gym.cli.terminal import Command, show
from collaborative_gym.cli.train import Train
from collaborative_gym.errors import UnknownName, unknown, with_remedy
from collaborative_gym.plugins import load_modules, location_of

_CANNOT, _BAD_INPUT, _INTERRUPTED, _UNREAD, _TERMINATED = 1, 2, 130, 141, 143

_PACKAGE = Path(__file__).parents[1]

_NO_FILE = FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError

_BAD = LookupError, ValueError, TypeError, *_NO_FILE
"""Errors of bad input, such as a path where no file can be."""

_CANNOT_BE_DONE = ImportError, OSError, RuntimeError
"""Errors where the machine lacks something."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status.

    Args:
      argv: the arguments, without the program's name; None for those of this process.

    Returns:
      0 when done, 1 where the machine lacks something, 2 for bad input, 130 after
      Ctrl-C, 141 if nobody reads the output any more, as after `| head`, 143 after
      SIGTERM. Nothing half-written is left in any case.
    """
    arguments = sys.argv[1:] if argv is None else list(argv)
    try:
        with _heeding_sigterm():
            _run(arguments)
    except KeyboardInterrupt as stop:
        return _end(str(stop), _INTERRUPTED)
    except _Terminated:
        return _TERMINATED
    except BrokenPipeError:
        _drop_output()
        return _UNREAD
    except Exception as error:
        return _fail(error, arguments)
    return 0


_VERBS = {
    "list": commands.List,
    "view": commands.View,
    "record": commands.Record,
    "train": Train,
    "evaluate": commands.Evaluate,
    "tournament": Tournament,
    "compare": Compare,
    "report": Report,
    "reproduce": commands.Reproduce,
    "certify": commands.Certify,
    "check": commands.Check,
    "benchmark": commands.Benchmark,
    "demo": commands.Demo,
}

_INSTEAD = {
    ("evaluate", "--output"): "--json FILE for all numbers, or --csv FILE for episodes",
    ("benchmark", "--output"): "--json FILE",
    ("report", "--policy"): "--policies",
    ("record", "--episodes"): "--only-episodes, or --seconds",
    ("record", "--width"): "--size WIDTH HEIGHT",
}
"""Options that other commands have, and what a command has in their place."""

_PLAINLY = {
    r"^Error parsing ": "",
    r": .*int\(\) with base 10: ('.*')$": r": \1 is not a whole number; write it as"
    " 300000 or 3e5",
    r": .*string to float: ('.*')$": r": \1 is not a number; write it as 0.001 or 1e-3",
    r": Could not .*$": " takes numbers, with spaces between them",
    r"^Missing from \S+ (\w+): ((?:--\S+ )?[^\s,]+),? (?:\|.*? \.\.\. )?(.*?)"
    r"(?:: |\. |\.? \().*": r"\1 needs \2, \3",
    r"^Missing value for argument '(.*)'\. Expected (.*)\.$": r"\1 takes \2",
    r" 1 values$": " a value",
    "^--size takes 2 values$": "--size takes a width and a height, such as 640 360",
}
"""Patterns of the parser's errors, and our words in their place."""

_DESCRIPTION = """Robot arms that cooperate or compete: watch, train, measure.

COMMAND --help lists the options of a command, with examples."""

_ENV = r"[A-Z][\w-]*"
"""What ids of environments and tasks look like, but no policy, robot, seed or file."""


class _Terminated(BaseException):
    """SIGTERM came. Like Ctrl-C it passes through to what cleans up."""


@contextmanager
def _heeding_sigterm() -> Iterator[None]:
    """Raise `_Terminated` on SIGTERM while the context lasts."""

    def end(*_: object) -> None:
        raise _Terminated

    if threading.current_thread() is not threading.main_thread():
        yield  # Only the main thread may set what a signal does.
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def _run(arguments: list[str]) -> None:
    if arguments in (["--version"], ["-V"]):
        show(f"collaborative-gym {version('collaborative-gym')}")
        return
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:], "--help"]
    # The parser takes no 1e6 for a whole number, and a setting may be one, too.
    large = re.compile(r"(^|=)([1-9](\.\d)?e[1-9])$")
    arguments = [
        large.sub(lambda of: f"{of[1]}{float(of[2]):.0f}", word) for word in arguments
    ]
    verb = arguments[0] if arguments else ""
    for word in arguments:
        option, _, value = word.partition("=")
        if re.fullmatch("-[a-gi-zA-Z]", word):
            who = verb if verb in _VERBS else "collaborative-gym"
            raise UnknownName(f"{who} does not take {word}; options begin with --")
        if "None" in (word, value):
            raise ValueError("None is no value; leave the option out")
        if (verb, option) in _INSTEAD:
            instead = _INSTEAD[verb, option]
            raise ValueError(f"{verb} has no {option}; give {instead}")
    if verb in _VERBS:  # Reading the options of one command is quicker.
        command = _read(_VERBS[verb], verb, arguments[1:])
    elif verb[:1] not in ("", "-"):
        raise UnknownName(unknown("command", verb, list(_VERBS)))
    else:
        arguments = arguments or ["--help"]
        command = _parse(_any_command(), "", arguments)
    _check_given(command, arguments)
    if isinstance(command, Command):
        load_modules(command.module)
    command.run()


def _read(kind: type, verb: str, words: list[str]) -> Any:
    """Return a command with its options.

    If it lacks environments, they are the last values of an option that takes several.
    One value stays with the option, since a policy may have an environment's name.
    """
    pairs = enumerate(pairwise(["-", *words]))
    late = {i for i, (a, b) in pairs if a[:1] != "-" and re.fullmatch(_ENV, b)}
    if not late or words[0][:1] != "-":
        return _parse(kind, verb, words)
    try:
        command = _parse(kind, verb, words)
        if getattr(command, "envs", True):
            return command
    except (UnknownName, ValueError):
        pass  # The words may be right in another order.
    first = sorted(range(len(words)), key=lambda i: i not in late)
    return _parse(kind, verb, [words[i] for i in first])


def _parse(kind: Any, verb: str, words: list[str]) -> Any:
    """Return what `tyro.cli` does, but raise an error where it would print a box.

    Raises:
      UnknownName: if it has no use for a word.
      ValueError: if a value is wrong or missing.
    """
    prog, helps = f"collaborative-gym {verb}".strip(), {"-h", "--help"} & {*words}
    if whole := verb == "train" and "--help-all" in words:
        helps = words = ["--help"]
    if verb:
        # The parser lists a command's own options first, then those of its bases.
        fields = kind.__dataclass_fields__
        kind.__dataclass_fields__ = {name: fields[name] for name in owners(kind)}
    # The parser looks at the stream for how to draw.
    page = type("Page", (StringIO,), {"encoding": sys.stdout.encoding})()
    about = None if verb else _DESCRIPTION
    with redirect_stderr(StringIO()) as box, redirect_stdout(page):
        try:
            return tyro.cli(kind, prog=prog, description=about, args=words)
        except SystemExit as end:
            status = end.code
    if status != _BAD_INPUT:
        brief = page.getvalue().replace(f"{{{','.join(_VERBS)}}}", "COMMAND ...")
        # A script of completions is to stay as it is.
        sys.stdout.write(finished(brief, verb, kind, whole) if helps else brief)
        raise SystemExit(status)
    raise _complaint(box.getvalue(), prog.split()[-1], kind)


def _complaint(box: str, verb: str, kind: Any) -> Exception:
    """Return the error of a box that the parser would print about a command."""
    # Between its first two rules are the words; then come like names, or the help.
    parts = re.split(r"^(?:╭.*| ?[│ ]*[-─]{9,}[│ ]*)$", box, flags=re.M)
    text = " ".join(parts[1].replace("│", " ").split())
    if misplaced := re.match(r"Unrecognized or misplaced options: (\S+)", text):
        return UnknownName(f"{misplaced[1]} comes after a command; see {verb} --help")
    if unused := re.match(r"Unrecognized options: (([^\s,=]+).*)", text):
        with redirect_stdout(StringIO()) as page, suppress(SystemExit):
            tyro.cli(kind, args=["--help"])
        options = re.findall(r"--[a-z][\w-]+", page.getvalue())
        words = re.findall(r"--[^\s,=]+", unused[1]) or [unused[2]]
        for i, word in enumerate(words):
            near = get_close_matches(word, options, 1)
            words[i] += f" (did you mean {near[0]}?)" if near else ""
        what, how = " and ".join(words), f"{verb} --help lists what it takes"
        return UnknownName(f"{verb} does not take {what}; {how}")
    if wrong := re.search(
        r"choice '(.*)' for argument '--(.*?)s?'.* of \((.*)\)", text
    ):
        given, what, names = wrong.groups()
        able = {*re.findall(r"'(.+?)'", names)} - {"None"}
        return UnknownName(unknown(what, given, able))
    for pattern, plain in _PLAINLY.items():
        text = re.sub(pattern, plain, text)
    return ValueError(text)


def _check_given(command: Any, arguments: list[str]) -> None:
    """Raise ValueError if an option has no values, or an environment is there twice."""
    for name, value in vars(command).items():
        option = f"--{name.replace('_', '-')}"
        if value == () and option in arguments:
            raise ValueError(f"{option} takes a value, or several, got none")
    envs = getattr(command, "envs", ())
    for env in envs:
        if envs.count(env) > 1:
            raise ValueError(f"{env} is named twice; name each environment once")


def _any_command() -> Any:
    kinds = [
        Annotated[kind, tyro.conf.subcommand(verb, description=doc.partition("\n")[0])]
        for verb, kind in _VERBS.items()
        if (doc := kind.__doc__)
    ]
    return functools.reduce(operator.or_, kinds)


def _in_options(words: str, arguments: list[str]) -> str:
    """Return an error's words with options as they were typed."""
    for option in {word.partition("=")[0] for word in arguments if word[:2] == "--"}:
        name = option[2:].replace("-", "_")
        plain = "^|each of |give |as |in |leave out |without "
        where = r"(?<![\w.-])" if "_" in name else plain
        pattern = rf"({where}){re.escape(name)}(?!\w)"
        words = re.sub(pattern, lambda found, own=option: found[1] + own, words)
    return words


def _fail(error: Exception, arguments: list[str]) -> int:
    """Print what is wrong, and where in a user's file; raise if it is our own bug."""
    cannot = isinstance(error, _CANNOT_BE_DONE) and not isinstance(error, _BAD)
    location, words = location_of(error), str(error)
    if isinstance(error, OSError) and error.errno is not None:
        of = error.filename or "a file without a name, such as the output"
        words = f"the system says {error.strerror!r} of {of}"
        _drop_output()
    if location and not re.search(r"\w\.py, line \d", words):
        # Python's own words are often not a sentence, as those of a KeyError.
        raised_in = traceback.extract_tb(error.__traceback__)[-1].filename
        if _PACKAGE not in Path(raised_in).parents:
            words = f"{type(error).__name__}: {with_remedy(words)}"
        words = f"{words} ({location})"
    elif not (location or cannot or isinstance(error, _BAD)):
        raise error
    words = _in_options(words, arguments)
    return _end(f"error: {words}", _CANNOT if cannot else _BAD_INPUT)


def _drop_output() -> None:
    """Forget output that its file does not take, or Python's own end fails, too."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _end(last_words: str, status: int) -> int:
    if last_words:
        Console(stderr=True).print(
            last_words, markup=False, highlight=False, soft_wrap=True
        )
    return status
