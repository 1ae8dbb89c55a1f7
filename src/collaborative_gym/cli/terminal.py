"""Arguments that the commands share, and their output to the terminal."""

import ast
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich import box
from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.table import Table

from collaborative_gym.errors import look_up
from collaborative_gym.files import check_writable, write_text
from collaborative_gym.robots import Robot
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.task import Task

if TYPE_CHECKING:
    from rich.markdown import Markdown

_GAP = 2  # spaces between the columns of a table

_SPACES = re.compile(r"\n|(?<![\dN]) | (?=to\b|\d)")
"""Where a cell may fold, which leaves a number and its unit together."""

_LINE_INTERVAL = 10.0
"""Least time between two lines of progress where there is no terminal, in s."""


def option(metavar: str, default: str = "") -> Any:
    """Return how help shows an option: its value, and what holds without it."""
    hint = default and f"(default: {default})"
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=hint)


Flag = Annotated[
    tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(help_behavior_hint="")
]
Modules = Annotated[tyro.conf.UseAppendAction[tuple], option("MODULE", "none")]


@dataclass(frozen=True, kw_only=True)
class Command:
    """The options of commands that name environments.

    Attributes:
      module: file (.py) or installed module with tasks or arms of your own; repeatable.
    """

    module: Modules = ()

    def run(self) -> None:
        """Do what the command says, once its modules are loaded."""
        raise NotImplementedError


OWN_SIZE = (-1, -1)
"""Stands for the usual size of videos of a format."""

Env = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ENV")]
Envs = Annotated[tyro.conf.Positional[tuple[str, ...]], option("[ENV ...]")]
Policies = Annotated[
    tuple[str, ...], tyro.conf.arg(metavar="POLICY | AGENT=POLICY ...")
]
Randomization = Annotated[str, tyro.conf.arg(metavar="PRESET")]
Action = Annotated[str | None, option("MODE", "the environment's, joints")]
Settings = Annotated[tuple[str, ...], option("NAME=VALUE ...", "the environment's")]
Robots = Annotated[tuple[str, ...], option("ROBOT ...", "the environment's")]
NumRobots = Annotated[int | None, option("INT", "the environment's")]
File = Annotated[Path | None, option("FILE", "none")]
Looks = Annotated[tuple[str, ...], option("ARM=FILE ...", "the arm's own")]
Folder = Annotated[Path | None, option("FOLDER", "none")]
NumEnvs = Annotated[int | None, option("INT", "at most 64")]
Size = Annotated[tuple[int, int], option("WIDTH HEIGHT", "1280 720, of a GIF 416 234")]


def chosen_task(
    env: str,
    robots: Sequence[str | Robot],
    num_robots: int | None,
    randomization: str | None,
    action: str | None,
    settings: Sequence[str],
) -> Task:
    """Return the task that options choose, which are empty where they are not given."""
    own: dict[str, Any] = {} if action is None else {"action": action}
    for word in settings:
        name, _, value = word.partition("=")
        if not value:
            raise ValueError(
                "--settings takes each name with its value, such as wrench=raw, got"
                f" {word!r}"
            )
        if name in ("robots", "num_robots", "randomization", "action"):
            flag = f"--{name.replace('_', '-')}"
            raise ValueError(f"give {name} by {flag}, not by --settings")
        try:
            own[name] = ast.literal_eval(value)
        except (ValueError, SyntaxError):  # A word, such as raw or true.
            own[name] = {"true": True, "false": False}.get(value, value)
    arms = robots[0] if len(robots) == 1 else robots or None
    own |= {"num_robots": num_robots, "randomization": randomization}
    return make_task(env, arms, **own)


@dataclass(frozen=True, kw_only=True)
class Worlds(Command):
    """The options of commands that start episodes.

    Attributes:
      robots: robots in place of the environment's own, one per agent, or one for all.
      num_robots: number of robots of one kind, for tasks with teams of any size.
      randomization: how starts are drawn: {default,paper,wide,lost,hard}; see
        docs/concepts.md.
      action: what actions mean: {joints,tcp,tcp_position,impedance,
        impedance_stiffness,torques}; see docs/concepts.md.
      settings: other settings of the task, as cg.make takes them, such as wrench=raw.
      seed: seed of the episodes; another seed gives others.
    """

    robots: Robots = ()
    num_robots: NumRobots = None
    randomization: Randomization = "default"
    action: Action = None
    settings: Settings = ()
    seed: int = 0

    def task(self, env: str) -> Task:
        """Return the task of this name, with these options."""
        if joined := [word for word in self.robots if "," in word]:
            raise ValueError(f"--robots: separate names by spaces, got {joined[0]!r}")
        return chosen_task(env, self.robots, *self._how)

    @property
    def _how(self) -> tuple[Any, ...]:
        return self.num_robots, self.randomization, self.action, self.settings


@dataclass(frozen=True, kw_only=True)
class Played(Worlds):
    """The options of commands in which policies play.

    Attributes:
      any_env: let a trained policy play an environment that it was not trained for.
    """

    any_env: Flag = False


@dataclass(frozen=True, kw_only=True)
class Watched(Played):
    """The options of commands that show policies at play.

    Attributes:
      look: model files with other shapes of arms, such as the makers' meshes, in which
        they are drawn: panda=FILE. They change no physics.
    """

    look: Looks = ()

    def task(self, env: str) -> Task:
        """Return the task of this name, with arms that look so."""
        task, files = super().task(env), {}
        names = [robot.name for robot in task.robots.values()]
        for word in self.look:
            name, _, file = word.partition("=")
            if not file:
                raise ValueError(
                    "--look takes the arm before its file, such as panda=panda.xml,"
                    f" got {word!r}"
                )
            look_up("robot", name, dict.fromkeys(names))
            files[name] = file
        if not files:
            return task
        robots = [
            replace(robot, look=files.get(robot.name, robot.look))
            for robot in task.robots.values()
        ]
        return chosen_task(env, robots, None, *self._how[1:])


@dataclass(frozen=True, kw_only=True)
class Measured(Played):
    """The options of commands that play many episodes and print numbers.

    Attributes:
      num_envs: worlds that play at the same time; the results do not depend on it.
      num_threads: physics threads, 0 for one per CPU; the results do not depend on it.
      json: file for all numbers; - for standard output.
    """

    num_envs: NumEnvs = None
    num_threads: int = 0
    json: File = None


STANDARD_OUTPUT = Path("-")
"""Stands for standard output where a file is named."""

Progress = Callable[[str], Callable[[float], None]]
"""Adds a named bar and returns what sets its share, 0 to 1."""


def read_policy(words: Sequence[str]) -> str | dict[str, str]:
    """Return the policy that is named by one word, or by one for each agent.

    Raises:
      ValueError: if there is none, or more than one.
    """
    policies = read_policies(words)
    if len(policies) != 1:
        raise ValueError(
            "--policy takes one policy, or one for each robot as in robot_1=baseline"
            f" robot_2=idle, got {' '.join(words) or 'none'}"
        )
    return policies[0]


def read_policies(words: Sequence[str]) -> list[str | dict[str, str]]:
    """Return policies; words like robot_1=baseline that follow each other are one."""
    from collaborative_gym.policies.policy import split_word

    policies: list[str | dict[str, str]] = []
    for word in words:
        agent, name = split_word(word)
        last = policies[-1] if policies else ""
        if not agent:
            policies.append(word)
        elif isinstance(last, dict) and agent not in last:
            last[agent] = name
        else:
            policies.append({agent: name})
    return policies


def check_files(*paths: Path | None) -> None:
    """Raise before the work if one of the files cannot be written."""
    given = [path for path in paths if path is not None]
    if len(set(given)) < len(given):
        raise ValueError(f"{given[0]} is named for two outputs; name two files")
    for path in given:
        if path != STANDARD_OUTPUT:
            check_writable(path)


def put(path: Path | None, text: str) -> None:
    """Write a text file, or standard output; nothing where none is named."""
    if path == STANDARD_OUTPUT:
        sys.stdout.write(text)
    elif path is not None:
        write_text(path, text)


def drawn(draw: Callable[..., object], *given: Any) -> str:
    """Draw a picture; return nothing, or what to add to a sentence if it cannot be."""
    try:
        draw(*given)
    except ImportError as error:
        return f", but no picture: {error}"
    return ""


class _Output(Console):
    """A console that leaves it to `main` what to do if nobody reads any more."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def new_table(
    heads: Iterable[str],
    rows: Iterable[Sequence[Any]],
    *,
    words: int = 1,
    title: str | None = None,
    caption: str | None = None,
) -> Table:
    """Return a table whose first columns, `words` of them, have no numbers."""
    table = Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        collapse_padding=True,
        title=title,
        title_justify="left",
        caption=caption,
        caption_justify="left",
    )
    for i, head in enumerate(heads):
        table.add_column(head, justify="left" if i < words else "right")
    for row in rows:
        table.add_row(*row)
    return table


def fitted(table: Table, room: int) -> Table:
    """Return a table no wider than the room: rich itself would cut off numbers.

    Cells fold between words. If that is not enough, rows become names and values.
    """
    columns = [[str(c) for c in (each.header, *each.cells)] for each in table.columns]
    # A name of more than half of the room may break within; no number is so long.
    least = [
        min(max(len(part) for cell in cells for part in _SPACES.split(cell)), room // 2)
        for cells in columns
    ]
    most = [max(map(len, "\n".join(cells).split("\n"))) for cells in columns]
    left = room - _GAP * (len(columns) - 1) - sum(least)
    if left < 0:
        return fitted(_stood_up(table, columns), room)
    # Numbers, which are on the right, fold last.
    for i in reversed(range(len(columns))):
        table.columns[i].width = min(most[i], least[i] + left)
        table.columns[i].overflow = "fold"
        left -= min(most[i] - least[i], left)
    return table


def _stood_up(table: Table, columns: Sequence[Sequence[str]]) -> Table:
    """Return a table of the same cells, each in a line with the head of its column."""
    heads, *rows = zip(*columns, strict=True)
    lines = [
        (" ".join(head.split()), cell)
        for row in rows
        for head, cell in (*zip(heads, row, strict=True), ("", " "))  # an empty line
        if cell
    ]
    upright = new_table(["", ""], lines, words=2)
    upright.title, upright.caption = table.title, table.caption
    upright.show_header = False
    return upright


def show(
    content: "Table | Markdown | str", *, besides: Sequence[Path | None] = ()
) -> None:
    """Print a table, a page or a text.

    It goes to standard error if results, which go to `besides`, go to standard output.
    """
    console = _Output(stderr=STANDARD_OUTPUT in besides)
    if isinstance(content, str):
        console.print(content, markup=False, highlight=False, soft_wrap=True)
        return
    if isinstance(content, Table):
        if not console.is_terminal:
            console.width = 1000  # A file is as wide as needed.
        content = fitted(content, console.width)
    console.print(content)


def warn(text: str) -> None:
    """Print what must not be overlooked on standard error."""
    console = Console(stderr=True)
    console.print(text, style="bold red", markup=False, highlight=False, soft_wrap=True)


@contextmanager
def continuing() -> Iterator[None]:
    """Say after Ctrl-C that the same command continues what was done in the context.

    Raises:
      KeyboardInterrupt: the same, with words for the user.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; the same command continues") from None


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """Show progress bars below one another while the context lasts.

    Where there is no terminal, lines show the progress instead.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda name: _lines(console, name)
        return
    shown = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn()
    bars = Bars(*shown, TimeRemainingColumn(), console=console, transient=True)

    def add(name: str) -> Callable[[float], None]:
        bar = bars.add_task(name, total=1.0)
        return lambda share: bars.update(bar, completed=share)

    with bars:
        yield add


def _lines(console: Console, name: str) -> Callable[[float], None]:
    """Return what prints a share as a line, now and then, and the end of long work."""
    started = printed = time.monotonic()

    def show(share: float) -> None:
        nonlocal printed
        is_last = share >= 1 and printed > started
        if is_last or time.monotonic() >= printed + _LINE_INTERVAL:
            printed = time.monotonic()
            console.print(f"{name}: {share:.0%}", markup=False, highlight=False)

    return show
