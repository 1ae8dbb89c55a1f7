"""The command that writes report cards."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from collaborative_gym.cli.terminal import (
    File,
    Folder,
    NumEnvs,
    Played,
    Policies,
    check_files,
    progress_bars,
    put,
    read_policies,
    tell,
)

if TYPE_CHECKING:
    from collaborative_gym.cards import ReportCard
    from collaborative_gym.tasks.task import Task


@dataclass(frozen=True, kw_only=True)
class Report(Played):
    """Write report cards: how good policies are, on a page for each environment.

    A card has completion, performance and time to success with intervals; how gently
    the arms act: clearance, speeds, torques, energy and changes of action; what each
    disturbance alone, and all together, change; and who plays how well with whom.

    Attributes:
      envs: environment ids, or tasks' names.
      policies: who is reported on, each given as for evaluate.
      episodes: number of episodes of each policy by itself.
      disturbed: number of episodes with each of the disturbances; 0 leaves them out.
      paired: number of episodes of each pairing of the policies and the expert; 0
        leaves them out.
      num_envs: worlds that play at the same time; the results do not depend on it.
      num_threads: physics threads, 0 for one per CPU; the results do not depend on it.
      output: folder for the pages, ENV.md with ENV.json and ENV.png.
      json: file for all numbers; - for standard output.
    """

    envs: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="ENV ...", help_behavior_hint="(required)"),
    ]
    policies: Policies = ("expert",)
    episodes: int = 1000
    disturbed: int = 100
    paired: int = 100
    num_envs: NumEnvs = None
    num_threads: int = 0
    output: Folder = None
    json: File = None

    def run(self) -> None:
        """Tell the cards and write their pages."""
        from rich.markdown import Markdown

        from collaborative_gym.cards import report_card
        from collaborative_gym.evaluation.table import to_json

        if not self.envs:
            raise ValueError("name the environments to report on")
        policies = read_policies(self.policies)
        tasks = [self.task(each) for each in self.envs]
        pages = {task: self._page(task) for task in tasks if self.output is not None}
        check_files(*pages.values(), self.json)
        cards, besides = {}, (self.json,)
        with progress_bars() as progress:
            for task in tasks:
                cards[task.name] = report_card(
                    task,
                    policies,
                    episodes=self.episodes,
                    disturbed=self.disturbed,
                    paired=self.paired,
                    seed=self.seed,
                    num_envs=self.num_envs,
                    num_threads=self.num_threads,
                    any_env=self.any_env,
                    on_progress=progress(task.name),
                )
        for card in cards.values():
            tell(Markdown(card.to_markdown()), besides=besides)
        put(self.json, to_json({n: card.plain() for n, card in cards.items()}))
        for task, page in pages.items():
            self._write(page, cards[task.name])

    def _page(self, task: "Task") -> Path:
        """Return the file of an environment's page."""
        return (self.output or Path()) / f"{task.name.replace('/', '_')}.md"

    def _write(self, page: Path, card: "ReportCard") -> None:
        """Write a card's page and numbers, and its picture, if it can be drawn."""
        from collaborative_gym.cards import draw_card

        put(page.with_suffix(".json"), card.to_json())
        chart, but = page.with_suffix(".png"), ""
        try:
            draw_card(card, chart)
        except ImportError as error:
            but = f", but no picture: {error}"
        put(page, card.to_markdown([] if but else [chart.name]))
        tell(f"wrote {page}{but}", besides=(self.json,))
