"""The commands that play, measure and show."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from collaborative_gym.certificate.budget import QUICK, Budget
from collaborative_gym.cli.terminal import (
    OWN_SIZE,
    Command,
    Env,
    Envs,
    File,
    Flag,
    Measured,
    Policies,
    Size,
    Watched,
    Worlds,
    check_files,
    continuing,
    option,
    progress_bars,
    put,
    read_policies,
    read_policy,
    show,
    warn,
)
from collaborative_gym.tasks.task import Task

# Everything else is imported by the command that needs it, so that help is quick.


@dataclass(frozen=True, kw_only=True)
class List(Command):
    """List the environments, with their robots and the policies that are shipped.

    Attributes:
      name: part of the ids, or of the tasks' names, to list.
      sizes: list the sizes of each agent's observation and action instead of the task
        and the policies. It builds every world, which takes seconds.
    """

    name: Annotated[tyro.conf.Positional[str], option("[NAME]", "all")] = ""
    sizes: Flag = False

    def run(self) -> None:
        """Print the table."""
        from collaborative_gym import list_robots, list_tasks
        from collaborative_gym.cli.environments import environments_table

        show(environments_table(self.name, self.sizes))
        if self.name:
            return
        show(
            f"\nMost robots ({', '.join(list_robots())})\ngo into most tasks"
            f"\n({', '.join(list_tasks())});\nan error says why others do not:\n"
            "  collaborative-gym record Lift --robots panda jaco --output lift.mp4"
        )


@dataclass(frozen=True, kw_only=True)
class _Policy(Command):
    """The option that names the players.

    Attributes:
      policy: who commands the robots: expert, random, baseline, ego, idle, gripping,
        frozen, an environment id (its baseline), a policy file or a training folder; or
        one for each robot (also limp, absent), such as robot_1=baseline robot_2=limp.
        See docs/concepts.md.
    """

    policy: Policies = ("expert",)


@dataclass(frozen=True, kw_only=True)
class Record(_Policy, Watched):
    """Write a video of a policy at work.

    Attributes:
      env: an environment's id, or a task's name.
      output: the video, .mp4 or .gif; missing folders are made.
      beside: other policies to show beside it in the same episodes, named likewise.
      seconds: least length of the film; the last episode is shown to its end.
      only_episodes: episodes to show instead of the first ones, such as the worst ones
        that evaluate names; not together with --seconds.
      size: width and height in pixels, of each policy's picture and its caption.
      speed: simulated seconds per second of the film, 0.1 to 2; 0.5 is slow motion.
      slow_motion: show steps of a team's progress, or a game's scores, more slowly.
      close_up: a body of the world, such as pot/pot, to show from nearby beside it; of
        several, the one that hands are nearest to, until they leave it.
    """

    env: Env
    output: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    beside: Annotated[
        Policies, tyro.conf.arg(help_behavior_hint="(default: none)")
    ] = ()
    seconds: Annotated[float | None, option("FLOAT", "10")] = None
    only_episodes: Annotated[tuple[int, ...], option("INDEX ...", "none")] = ()
    size: Size = OWN_SIZE
    speed: float = 1.0
    slow_motion: Flag = False
    close_up: Annotated[tuple[str, ...], option("BODY ...", "none")] = ()

    def run(self) -> None:
        """Write the file."""
        from collaborative_gym.pictures.recording import record

        with progress_bars() as progress:
            record(
                self.task(self.env),
                self.output,
                policy=[read_policy(self.policy), *read_policies(self.beside)],
                any_env=self.any_env,
                seconds=self.seconds,
                seed=self.seed,
                only_episodes=self.only_episodes or None,
                size=None if self.size == OWN_SIZE else self.size,
                speed=self.speed,
                slow_motion=self.slow_motion,
                close_up=self.close_up,
                on_progress=progress(self.env),
            )
        show(f"wrote {self.output}")


@dataclass(frozen=True, kw_only=True)
class Evaluate(_Policy, Measured):
    """Measure a policy over many episodes: mean reward, completion, performance, time.

    Attributes:
      envs: environment ids, or tasks' names.
      all: evaluate every environment; with the policy baseline or ego, every one that
        has it. Give no ENV then.
      episodes: number of episodes in each environment.
      delay: number of control steps by which each action comes late.
      csv: file with one row per episode; - for standard output.
    """

    envs: Envs = ()
    all: Flag = False
    episodes: int = 200
    delay: int = 0
    csv: File = None

    def run(self) -> None:
        """Print a table and write the files."""
        from collaborative_gym.cli import tables
        from collaborative_gym.evaluation import evaluate, report
        from collaborative_gym.policies.policy import SHIPPED, shipped_kinds, split_word

        tasks = _tasks(self)
        policy = read_policy(self.policy)
        check_files(self.json, self.csv)
        named = {split_word(word)[1] for word in self.policy} & SHIPPED.keys()
        if self.all and named:
            names = [task.name for task in tasks]
            without = [each for each in names if named - {*shipped_kinds(each)}]
            tasks = [task for task in tasks if task.name not in without]
            show(
                f"left out because they have no {' or no '.join(sorted(named))}:"
                f" {', '.join(without)}",
                besides=(self.json, self.csv),
            )
        with progress_bars() as progress:
            reports = [
                evaluate(
                    task,
                    policy,
                    any_env=self.any_env,
                    episodes=self.episodes,
                    seed=self.seed,
                    delay=self.delay,
                    num_envs=self.num_envs,
                    num_threads=self.num_threads,
                    on_progress=progress(task.name),
                )
                for task in tasks
            ]
        shown = [tables.reports_table(reports, self._title())]
        if measured := [each for each in reports if each.coordination]:
            shown.append(tables.coordination_table(measured))
        for table in (*shown, tables.strain_table(reports)):
            show(table, besides=(self.json, self.csv))
        put(self.json, report.reports_to_json(reports))
        put(self.csv, report.reports_to_csv(reports))

    def _title(self) -> str:
        action = f", action {self.action}" if self.action else ""
        delay = f", delay {self.delay}" if self.delay else ""
        how = "".join([self.randomization, action, *(f", {s}" for s in self.settings)])
        return f"{' '.join(self.policy)} on {how}{delay}"


def _tasks(command: "Evaluate | Certify") -> list[Task]:
    """Return the tasks that a command names; a wrong name raises before the work.

    Raises:
      Exception: as `make_task` does.
    """
    from collaborative_gym import list_envs

    if command.all and command.envs:
        raise ValueError("name environments or pass --all, not both")
    env_ids = list_envs() if command.all else command.envs
    if not env_ids:
        verb = type(command).__name__.lower()
        raise ValueError(f"name the environments to {verb}, or pass --all")
    return [command.task(env_id) for env_id in env_ids]


@dataclass(frozen=True, kw_only=True)
class Reproduce:
    """Compare the shipped baselines with the thesis, number by number.

    Attributes:
      table: which table of the thesis: table11, its results.
      episodes: number of episodes for each environment and policy.
      seed: seed of the episodes; another seed gives others.
      num_threads: physics threads, 0 for one per CPU; the results do not depend on it.
      output: where table11.md and table11.json go.
    """

    table: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="TABLE")]
    episodes: int = 200
    seed: int = 0
    num_threads: int = 0
    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/table11")

    def run(self) -> None:
        """Print the table and write the files; the last line is the verdict."""
        from collaborative_gym.cli.tables import table11_table
        from collaborative_gym.errors import look_up
        from collaborative_gym.evaluation import reproduce_table11
        from collaborative_gym.files import write_text

        look_up("table", self.table, {"table11": None})
        markdown, json = self.output / "table11.md", self.output / "table11.json"
        check_files(markdown, json)
        with progress_bars() as progress:
            table11 = reproduce_table11(
                self.episodes,
                self.seed,
                num_threads=self.num_threads,
                on_progress=progress("table11"),
            )
        show(table11_table(table11))
        write_text(markdown, table11.to_markdown())
        write_text(json, table11.to_json())
        show(f"wrote {markdown} and {json}\n{table11.verdict}")


@dataclass(frozen=True, kw_only=True)
class Certify(Worlds):
    """Try to do tasks while one arm is still, to show that all arms are needed.

    Each arm in turn is still while the others play the expert, motions that a search
    finds, and policies that are trained for this; see docs/certify.md. It takes hours.
    You can stop it at any time; the same command then continues.

    Attributes:
      envs: environment ids, or tasks' names.
      all: certify every environment; then name none.
      quick: take only seconds. This shows that certify works, and proves nothing.
      num_threads: physics threads, 0 for one per CPU; the results do not depend on it.
      output: where certificates.md goes, and a folder for each environment.
      budget: how hard it tries.
    """

    envs: Envs = ()
    all: Flag = False
    quick: Flag = False
    num_threads: int = 0
    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/certificates")
    budget: Annotated[Budget, tyro.conf.arg(name="")] = field(default_factory=Budget)

    def run(self) -> None:
        """Print each trial and the table, and write the files."""
        from collaborative_gym.certificate.certify import certify
        from collaborative_gym.certificate.report import certificates_to_markdown
        from collaborative_gym.cli.tables import certificates_table
        from collaborative_gym.files import write_text

        tasks = _tasks(self)
        if self.quick and self.budget != Budget():
            raise ValueError("--quick has a budget of its own; give it alone")
        markdown = self.output / "certificates.md"
        check_files(markdown)
        certificates = []
        with continuing(), progress_bars() as progress:
            for task in tasks:
                name = task.name
                show(f"{name}: each arm in turn is still; each trial prints a line")
                certificate = certify(
                    task,
                    budget=QUICK if self.quick else self.budget,
                    seed=self.seed,
                    output=self.output / name.replace("/", "-"),
                    num_threads=self.num_threads,
                    on_trial=lambda trial, name=name: show(f"{name}, {trial.title}"),
                    on_progress=progress(name),
                )
                certificates.append(certificate)
                write_text(markdown, certificates_to_markdown(certificates))
        show(certificates_table(certificates))
        for certificate in certificates:
            show(certificate.statement)
        show(f"wrote {markdown}")


@dataclass(frozen=True, kw_only=True)
class Check(Worlds):
    """Check that a task of your own keeps every promise that environments make.

    Attributes:
      env: an environment's id, or a task's name.
      episodes: number of the expert's episodes.
    """

    env: Env
    episodes: int = 20
    seed: Annotated[int, tyro.conf.Suppress] = 0

    def run(self) -> None:
        """Print that all is well, or every broken promise and its remedy."""
        from collaborative_gym.plugins import location_of
        from collaborative_gym.testing import check_task

        with warnings.catch_warnings(record=True) as told:
            try:
                with progress_bars() as progress:
                    told_of = progress(f"checking {self.env}")
                    task = self.task(self.env)
                    check_task(task, episodes=self.episodes, on_progress=told_of)
            except (AssertionError, RuntimeError) as error:
                if location_of(error):
                    raise
                show(str(error))
                raise SystemExit(1) from error
            finally:
                for each in told:
                    show(f"{each.message}")
        show(f"{self.env} keeps every promise{' that was tested' * bool(told)}")


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    """Measure how fast the environments are, and how fast the physics alone is.

    Attributes:
      envs: environment ids, or tasks' names. (default: all ids)
      num_envs: worlds to step together.
      num_threads: physics threads, 0 for one per CPU.
      json: file for the numbers and the machine's description; - for standard output.
    """

    envs: Envs = ()
    num_envs: int = 256
    num_threads: int = 0
    json: File = None

    def run(self) -> None:
        """Print a table and write the file."""
        from collaborative_gym import list_envs
        from collaborative_gym.cli.tables import benchmark_table
        from collaborative_gym.evaluation.machine import cores
        from collaborative_gym.evaluation.speed import benchmark

        check_files(self.json)
        if self.num_threads > cores():
            warn(f"{self.num_threads} threads share {cores()} CPUs, which is slower")
        with progress_bars() as progress:
            measured = benchmark(
                self.envs or list_envs(),
                self.num_envs,
                num_threads=self.num_threads,
                on_progress=progress("benchmark"),
            )
        show(benchmark_table(measured), besides=(self.json,))
        put(self.json, measured.to_json())


@dataclass(frozen=True, kw_only=True)
class View(_Policy, Watched):
    """Watch a policy in real time, and pull things to disturb it.

    It opens a window, or serves a page for the browser if it cannot open one. On the
    page you can change environment, robots, policies and starts without a restart.

    Attributes:
      env: an environment's id, or a task's name.
      num_envs: worlds to show beside one another in the browser, up to 16.
      web: serve a page for the browser, even if a window can be opened.
      host: address of the page. Whoever can reach it can control the robots.
      port: port of the page; if it is in use, the next free one is taken.
    """

    env: Env
    num_envs: int = 1
    web: Flag = False
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    port: int = 8080

    def run(self) -> None:
        """Show it until the window is closed, or until Ctrl-C."""
        from collaborative_gym.viewer import view
        from collaborative_gym.viewer.launch import HERE

        address = self.host, self.port
        view(
            self.task(self.env),
            show,
            warn=warn,
            policy=read_policy(self.policy),
            any_env=self.any_env,
            seed=self.seed,
            num_envs=self.num_envs,
            address=address if self.web or address != HERE else None,
        )


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Film the thesis's environments and Hockey, and compare baselines with the thesis.

    It takes some minutes on two cores. A sheet of pictures comes first, then films,
    then a table. Where an environment has no baseline, its expert plays.

    Attributes:
      output: where the files go.
      episodes: number of episodes for each environment and policy.
    """

    output: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out")
    episodes: int = 32

    def run(self) -> None:
        """Print each file once it is written, then the tables and how to watch."""
        from collaborative_gym.cli import demo
        from collaborative_gym.cli.tables import table11_table
        from collaborative_gym.errors import check_count
        from collaborative_gym.evaluation import reproduce_table11
        from collaborative_gym.files import write_text

        check_count("episodes", self.episodes, at_least=1)
        files = self.output / "table11.json", self.output / "table11.md"
        check_files(*files)
        self._draw()
        show(
            f"now it measures {self.episodes} episodes of each baseline, of each expert"
            " and of random actions; that takes some minutes, and Ctrl-C ends it"
        )
        with progress_bars() as progress:
            table11 = reproduce_table11(
                self.episodes,
                on_progress=progress("baselines, experts, random actions"),
            )
        write_text(files[0], table11.to_json())
        write_text(files[1], table11.to_markdown())
        show(table11_table(table11))
        show(table11.verdict)
        show(
            f"The pictures, films and numbers are in {self.output}/. To play all 200"
            f" episodes of the thesis:\n  {demo.program()} reproduce table11\n"
            "To watch robots in the browser:\n"
            f"  {demo.program()} view {next(iter(demo.players()))} --policy baseline"
            " --web"
        )

    def _draw(self) -> None:
        from collaborative_gym.cli import demo
        from collaborative_gym.pictures import recording

        show(
            "first a sheet (seconds), then films (one to several minutes), then a table"
            " beside the thesis's"
        )
        try:
            recording.check_ready()
        except (ImportError, RuntimeError) as error:
            show(f"no films and pictures can be made: {error}")
            return
        films = len(demo.players()) + 1
        for number, path in enumerate(demo.draw(self.output)):
            sheet = f"wrote {path}; {films} films follow, each named once it is there"
            show(f"film {number} of {films}: {path}" if number else sheet)
