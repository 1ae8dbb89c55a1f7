"""The commands that compare policies and training runs, and report on them."""

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from collaborative_gym.cli.terminal import (
    Env,
    File,
    Folder,
    Measured,
    Policies,
    check_files,
    continuing,
    drawn,
    option,
    progress_bars,
    put,
    read_policies,
    show,
)

# Everything else is imported by the command that needs it, so that help is quick.


@dataclass(frozen=True, kw_only=True)
class Tournament(Measured):
    """Measure cross-play: every policy in every seat with every other, and itself.

    A seat is a robot; if robots play against one another, it is a side. Players that
    work together are compared by completion, performance and return; opponents by wins,
    scores and ratings on Elo's scale. Every pairing plays the same episodes. Policies
    in one folder count as training runs of one kind, with own results; see --groups.

    Attributes:
      env: an environment's id, or a task's name.
      policies: two players or more, each as --policy of evaluate takes it.
      episodes: number of episodes of each pairing.
      seats: seats that each player takes in turn, while another player has the others:
        all, or the names of some, which saves games with three robots or more.
      groups: players that are training runs of one kind, each after the kind's name,
        such as gentle=runs/one gentle=runs/two; by default those in one folder.
      output: folder for tournament.json, .csv and .png, and for a file of each pairing.
        You can stop at any time; the same command continues, also with more players.
    """

    env: Env
    policies: Policies
    episodes: int = 100
    seats: Annotated[tuple[str, ...], tyro.conf.arg(metavar="all | SEAT ...")] = (
        "all",
    )
    groups: Annotated[tuple[str, ...], option("KIND=PLAYER ...", "by folder")] = ()
    output: Folder = None

    def run(self) -> None:
        """Print each pairing and the tables, and write the files."""
        from collaborative_gym.cli.tables import tournament_tables
        from collaborative_gym.tournaments.picture import draw_tournament
        from collaborative_gym.tournaments.play import tournament

        names = ("tournament.json", "tournament.csv", "tournament.png")
        files = [self.output / name for name in names] if self.output else []
        check_files(*files, self.json)
        besides = (self.json,)
        stoppable = continuing() if self.output else nullcontext()
        with stoppable, progress_bars() as progress:
            played = tournament(
                self.task(self.env),
                read_policies(self.policies),
                episodes=self.episodes,
                seed=self.seed,
                seats=self.seats,
                groups=self._groups(),
                num_envs=self.num_envs,
                num_threads=self.num_threads,
                any_env=self.any_env,
                output=self.output,
                on_pairing=lambda each: show(each.title, besides=besides),
                on_progress=progress(self.env),
            )
        for table in tournament_tables(played):
            show(table, besides=besides)
            show("", besides=besides)
        put(self.json, played.to_json())
        if files:
            put(files[0], played.to_json())
            put(files[1], played.to_csv())
            but = drawn(draw_tournament, played, files[2])
            show(f"wrote {self.output}{but}", besides=besides)

    def _groups(self) -> dict[str, list[str]] | None:
        groups: dict[str, list[str]] = {}
        for word in self.groups:
            kind, _, player = word.partition("=")
            if not kind or not player:
                raise ValueError(
                    "--groups takes the kind of each training run before its player,"
                    f" such as gentle=runs/one gentle=runs/two, got {word!r}"
                )
            groups.setdefault(kind, []).append(player)
        return groups or None


@dataclass(frozen=True, kw_only=True)
class Report(Measured):
    """Write report cards: how good policies are, on a page for each environment.

    A card has results, strain, the effect of each disturbance, and cross-play.

    Attributes:
      envs: environment ids, or tasks' names.
      policies: policies to report on, each given as for evaluate.
      episodes: number of episodes of each policy by itself.
      disturbed: number of episodes with each of the disturbances; 0 leaves them out.
      paired: number of episodes of each pairing, also with the expert; 0 for none.
      output: folder for the pages, ENV.md with ENV.json and ENV.png.
    """

    envs: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="ENV ...", help_behavior_hint="(required)"),
    ]
    policies: Policies = ("expert",)
    episodes: int = 1000
    disturbed: int = 100
    paired: int = 100
    output: Folder = None

    def run(self) -> None:
        """Print the cards and write their pages."""
        from collaborative_gym.cards import draw_card, report_card
        from collaborative_gym.cli.tables import Page
        from collaborative_gym.evaluation.table import to_json

        if not self.envs:
            raise ValueError("name the environments to report on")
        policies = read_policies(self.policies)
        tasks = {task.name: task for task in map(self.task, self.envs)}
        pages: dict[str, Path] = {}
        if self.output is not None:
            pages = {n: self.output / f"{n.replace('/', '_')}.md" for n in tasks}
        check_files(*pages.values(), self.json)
        cards, besides = {}, (self.json,)
        with progress_bars() as progress:
            for name, task in tasks.items():
                cards[name] = report_card(
                    task,
                    policies,
                    episodes=self.episodes,
                    disturbed=self.disturbed,
                    paired=self.paired,
                    seed=self.seed,
                    num_envs=self.num_envs,
                    num_threads=self.num_threads,
                    any_env=self.any_env,
                    on_progress=progress(name),
                )
        for card in cards.values():
            show(Page(card.to_markdown()), besides=besides)
        put(self.json, to_json({n: card.plain() for n, card in cards.items()}))
        for name, page in pages.items():
            card, chart = cards[name], page.with_suffix(".png")
            put(page.with_suffix(".json"), card.to_json())
            but = drawn(draw_card, card, chart)
            put(page, card.to_markdown([] if but else [chart.name]))
            show(f"wrote {page}{but}", besides=besides)


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Compare training runs grouped by settings, with intervals over seeds.

    It finds the settings in which the runs differ. It prints interquartile means,
    medians and means of the last validations, the steps and core-seconds to 90 %
    completion, and the probability that a run of one kind beats one of another.

    Attributes:
      runs: folders of runs, or folders that have runs in them at any depth.
      measure: measure of the validations, such as return, for curves, profiles and
        probabilities.
      output: folder for compare.md, .csv, .json, .svg and .pdf, and marl_eval.json for
        the package id-marl-eval.
      json: file for all numbers; - for standard output.
    """

    runs: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="RUN | FOLDER ...", help_behavior_hint="(required)"),
    ]
    measure: Annotated[str | None, option("NAME", "completion")] = None
    output: Folder = None
    json: File = None

    def run(self) -> None:
        """Print tables and write the files."""
        from collaborative_gym.cli.tables import comparison_tables
        from collaborative_gym.comparisons.picture import draw_comparison
        from collaborative_gym.comparisons.result import compare

        folder = self.output or Path()
        kinds = () if self.output is None else ("md", "csv", "json", "svg", "pdf")
        files = {kind: folder / f"compare.{kind}" for kind in kinds}
        check_files(*files.values(), self.json)
        compared = compare(self.runs, measure=self.measure)
        besides = (self.json,)
        show(compared.statement, besides=besides)
        for table in comparison_tables(compared):
            show("", besides=besides)
            show(table, besides=besides)
        put(self.json, compared.to_json())
        if files:
            put(files["md"], compared.to_markdown())
            put(files["csv"], compared.to_csv())
            put(files["json"], compared.to_json())
            put(folder / "marl_eval.json", compared.to_marl_eval())
            but = drawn(draw_comparison, compared, files["svg"], files["pdf"])
            show(f"\nwrote {folder}{but}", besides=besides)
