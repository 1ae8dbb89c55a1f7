"""The command line."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

# Everything else is imported by the command that needs it, so that help is quick.

_CANNOT, _BAD_INPUT, _INTERRUPTED, _TERMINATED = 1, 2, 130, 143

_OWN_SIZE = (0, 0)
"""Stands for the size that videos of a format have unless told otherwise."""

_Env = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ENV")]
_Envs = Annotated[
    tyro.conf.Positional[tuple[str, ...]],
    tyro.conf.arg(metavar="[ENV ...]", help_behavior_hint=""),
]
_Policy = Annotated[str, tyro.conf.arg(metavar="POLICY")]
_Randomization = Annotated[str, tyro.conf.arg(metavar="PRESET")]
_Robots = Annotated[
    tuple[str, ...],
    tyro.conf.arg(metavar="ROBOT ...", help_behavior_hint="(default: its own)"),
]
_Agents = Annotated[
    tuple[str, ...],
    tyro.conf.arg(metavar="AGENT ...", help_behavior_hint="(default: none)"),
]
_File = Annotated[
    Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")
]
_Size = Annotated[
    tuple[int, int],
    tyro.conf.arg(
        metavar="WIDTH HEIGHT",
        help_behavior_hint="(default: 640 480, of a GIF 320 240)",
    ),
]

_Progress = Callable[[str], Callable[[float], None]]
"""Adds a named bar and returns what sets its share, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class List:
    """List the environments: robots, and each agent's observation and action sizes."""

    def run(self) -> None:
        """Print the table."""
        from collaborative_gym import list_envs, list_robots, list_tasks, make_vec
        from collaborative_gym.tables import environments_table

        envs = ((env_id, make_vec(env_id, 1, num_threads=1)) for env_id in list_envs())
        _print(environments_table(envs))
        _print(
            f"\nAny robots ({', '.join(list_robots())}) go into any task"
            f" ({', '.join(list_tasks())}):\n"
            "  collaborative-gym record Lift --robots panda jaco --output lift.mp4"
        )


@dataclass(frozen=True, kw_only=True)
class _World:
    """What is played.

    Attributes:
      policy: who commands the robots: expert or random.
      robots: robots to use instead of the environment's own, one per agent.
      randomization: how much starts differ: default, or paper for the thesis's fixed
        starts.
      seed: starts another series of episodes.
    """

    policy: _Policy = "expert"
    robots: _Robots = ()
    randomization: _Randomization = "default"
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class Record(_World):
    """Write a video of a policy at work, in real time.

    Attributes:
      env: environment id, or a task's name.
      output: the video, .mp4 or .gif.
      episodes: how many, one after the other.
      size: width and height in pixels.
    """

    env: _Env
    output: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    episodes: int = 1
    size: _Size = _OWN_SIZE

    def run(self) -> None:
        """Write the file."""
        from collaborative_gym.recording import record

        with _progress() as progress:
            record(
                self.env,
                self.output,
                self.policy,
                self.episodes,
                self.seed,
                self.robots or None,
                self.randomization,
                None if self.size == _OWN_SIZE else self.size,
                progress(self.env),
            )
        _print(f"wrote {self.output}")


@dataclass(frozen=True, kw_only=True)
class Evaluate(_World):
    """Measure a policy over many episodes: mean reward, completion, performance.

    Attributes:
      envs: environment ids, or tasks' names.
      all: evaluate every environment; name none then.
      episodes: how many per environment.
      num_envs: worlds to play in beside one another; the numbers do not depend on it.
      num_threads: physics threads, 0 for one per CPU; the numbers do not depend on it.
      idle: agents that hold still, such as robot_1.
      json: file for all statistics and episodes.
      csv: file with one row per episode.
    """

    envs: _Envs = ()
    all: tyro.conf.FlagCreatePairsOff[bool] = False
    episodes: int = 100
    num_envs: Annotated[
        int | None,
        tyro.conf.arg(metavar="INT", help_behavior_hint="(default: at most 64)"),
    ] = None
    num_threads: int = 0
    idle: _Agents = ()
    json: _File = None
    csv: _File = None

    def run(self) -> None:
        """Print a table and write the files."""
        from collaborative_gym import list_envs
        from collaborative_gym.evaluation import evaluate, report
        from collaborative_gym.files import write_text
        from collaborative_gym.tables import reports_table

        if self.all and self.envs:
            raise ValueError("name environments or pass --all, not both")
        env_ids = list_envs() if self.all else self.envs
        if not env_ids:
            raise ValueError("name the environments to evaluate, or pass --all")
        _check_files(self.json, self.csv)
        reports = []
        with _progress() as progress:
            for env_id in env_ids:
                reports.append(
                    evaluate(
                        env_id,
                        self.policy,
                        self.episodes,
                        self.seed,
                        self.robots or None,
                        self.randomization,
                        self.num_envs,
                        self.num_threads,
                        self.idle,
                        progress(env_id),
                    )
                )
        _print(reports_table(reports))
        if self.json is not None:
            write_text(self.json, report.reports_to_json(reports))
        if self.csv is not None:
            write_text(self.csv, report.reports_to_csv(reports))


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Measure the environments' speed beside that of the bare physics, in one run.

    Attributes:
      envs: environment ids, or tasks' names. (default: all ids)
      num_envs: worlds to step together.
      num_threads: physics threads, 0 for one per CPU.
      json: file for the numbers and the machine's description.
    """

    envs: _Envs = ()
    num_envs: int = 256
    num_threads: int = 0
    json: _File = None

    def run(self) -> None:
        """Print a table and write the file."""
        from collaborative_gym import list_envs
        from collaborative_gym.benchmark import benchmark
        from collaborative_gym.files import write_text
        from collaborative_gym.tables import benchmark_table

        _check_files(self.json)
        with _progress() as progress:
            measured = benchmark(
                self.envs or list_envs(),
                self.num_envs,
                self.num_threads,
                progress("benchmark"),
            )
        _print(benchmark_table(measured))
        if self.json is not None:
            write_text(self.json, measured.to_json())


@dataclass(frozen=True, kw_only=True)
class View(_World):
    """Watch a policy in a window, in real time.

    The same as `python -m collaborative_gym --env ENV`.

    Attributes:
      env: environment id, or a task's name.
      policy: who commands the robots: expert or random.
    """

    env: _Env
    policy: _Policy = "random"

    def run(self) -> None:
        """Show the window until it is closed."""
        from collaborative_gym.viewer import view

        robots = self.robots or None
        view(self.env, self.policy, self.seed, robots, self.randomization)


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Evaluate and film the expert of every environment; the files go to one folder.

    Attributes:
      output: where the files go.
      episodes: how many per environment.
    """

    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out")
    episodes: int = 20

    def run(self) -> None:
        """Print a table; write report.json, a video each and a contact sheet."""
        from collaborative_gym import demo, list_envs, recording
        from collaborative_gym.evaluation import evaluate, report
        from collaborative_gym.files import write_text
        from collaborative_gym.tables import reports_table

        env_ids = list_envs()
        _check_files(self.output / "report.json")
        with _progress() as progress:
            reports = [
                evaluate(env_id, "expert", self.episodes, on_progress=progress(env_id))
                for env_id in env_ids
            ]
        _print(reports_table(reports))
        write_text(self.output / "report.json", report.reports_to_json(reports))
        _print(f"wrote {self.output / 'report.json'}")
        try:
            recording.check_ready()
        except (ImportError, RuntimeError) as error:
            _print(f"no videos and pictures: {error}")
            return
        with _progress() as progress:
            advance = progress("videos")
            paths = []
            for path in demo.film(env_ids, self.output):
                paths.append(path)
                advance(len(paths) / (len(env_ids) + 1))
        for path in paths:
            _print(f"wrote {path}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status.

    Args:
      argv: the arguments, without the program's name; None for those of this process.

    Returns:
      0 when done, 1 where the machine lacks something, 2 for bad input, 130 after
      Ctrl-C, 143 after SIGTERM. Nothing half-written is left in any case.
    """
    try:
        with _heeding_sigterm():
            _run(sys.argv[1:] if argv is None else list(argv))
    except KeyboardInterrupt:
        return _INTERRUPTED
    except _Terminated:
        return _TERMINATED
    except (KeyError, ValueError, TypeError) as error:
        return _fail(error, _BAD_INPUT)
    except (ImportError, OSError, RuntimeError) as error:
        return _fail(error, _CANNOT)
    return 0


_Command = (
    Annotated[List, tyro.conf.subcommand("list")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Record, tyro.conf.subcommand("record")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Benchmark, tyro.conf.subcommand("benchmark")]
    | Annotated[Demo, tyro.conf.subcommand("demo")]
)


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
    if arguments == ["--version"]:
        _print(f"collaborative-gym {version('collaborative-gym')}")
        return
    command = tyro.cli(
        _Command,
        prog="collaborative-gym",
        description="Robot arms that must work together: watch, measure, record.\n\n"
        "With --version, say which version this is.",
        args=arguments,
    )
    command.run()


def _check_files(*paths: Path | None) -> None:
    """Raise if one of the files cannot be written, so that it shows before the work."""
    from collaborative_gym.files import check_writable

    given = [path for path in paths if path is not None]
    if len(set(given)) < len(given):
        raise ValueError(f"{given[0]} is named for two outputs; name two files")
    for path in given:
        check_writable(path)


def _fail(error: Exception, status: int) -> int:
    Console(stderr=True).print(
        f"error: {error}", markup=False, highlight=False, soft_wrap=True
    )
    return status


def _print(content: Table | str) -> None:
    console = Console()
    if isinstance(content, str):
        console.print(content, markup=False, highlight=False, soft_wrap=True)
    else:
        console.print(content)


@contextmanager
def _progress() -> Iterator[_Progress]:
    """Show progress bars below one another while the context lasts."""
    console = Console(stderr=True)
    bars = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )

    def add(name: str) -> Callable[[float], None]:
        bar = bars.add_task(name, total=1.0)
        return lambda share: bars.update(bar, completed=share)

    with bars:
        yield add
