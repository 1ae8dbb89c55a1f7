"""The command that lets policies play with one another."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from collaborative_gym.cli.terminal import (
    Env,
    File,
    Folder,
    NumEnvs,
    Played,
    Policies,
    check_files,
    continuing,
    progress_bars,
    put,
    read_policies,
    tell,
)

if TYPE_CHECKING:
    from collaborative_gym.tournaments.result import Tournament as Result


@dataclass(frozen=True, kw_only=True)
class Tournament(Played):
    """Let every policy play in every seat with every other, and with itself.

    A seat is a robot; if robots play against one another, it is a side. Players that
    work together are compared by completion, performance and return; opponents by wins,
    scores and ratings on Elo's scale. Every pairing plays the same episodes. Policies
    in one folder count as training runs of one kind, with results of their own, unless
    --groups says which do.

    Attributes:
      env: environment id, or a task's name.
      policies: two players or more, each given as for evaluate: expert, expert:late,
        random, baseline, ego, idle, gripping, frozen, or a path to a policy file or to
        a training folder. A player may have a policy for each robot, such as
        robot_1=baseline robot_2=idle.
      episodes: number of episodes of each pairing.
      seats: seats that each player takes in turn, while another player has the others:
        all, or the names of some, which saves games with three robots or more.
      groups: players that are training runs of one kind, with the kind's name before
        each, such as gentle=runs/one gentle=runs/two; else those in one folder.
      num_envs: worlds that play at the same time; the results do not depend on it.
      num_threads: physics threads, 0 for one per CPU; the results do not depend on it.
      output: folder for tournament.json, .csv and .png, and for a file of each pairing.
        You can stop at any time; the same command continues, also with more players.
      json: file for all numbers; - for standard output.
    """

    env: Env
    policies: Policies
    episodes: int = 100
    seats: Annotated[tuple[str, ...], tyro.conf.arg(metavar="all | SEAT ...")] = (
        "all",
    )
    groups: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="KIND=PLAYER ...", help_behavior_hint="(default: by folder)"
        ),
    ] = ()
    num_envs: NumEnvs = None
    num_threads: int = 0
    output: Folder = None
    json: File = None

    def run(self) -> None:
        """Tell each pairing, print tables and write the files."""
        from collaborative_gym.cli.tables import tournament_tables
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
                groups=_groups(self.groups),
                num_envs=self.num_envs,
                num_threads=self.num_threads,
                any_env=self.any_env,
                output=self.output,
                on_pairing=lambda each: tell(each.title, besides=besides),
                on_progress=progress(self.env),
            )
        for table in tournament_tables(played):
            tell(table, besides=besides)
            tell("", besides=besides)
        put(self.json, played.to_json())
        if files:
            put(files[0], played.to_json())
            put(files[1], played.to_csv())
            tell(_draw(played, files[2]), besides=besides)


def _groups(words: Sequence[str]) -> dict[str, list[str]] | None:
    """Return the players by kind; None where no kinds are named."""
    groups: dict[str, list[str]] = {}
    for word in words:
        kind, _, player = word.partition("=")
        if not kind or not player:
            raise ValueError(
                "--groups takes the kind of each training run before its player, such"
                f" as gentle=runs/one gentle=runs/two, got {word!r}"
            )
        groups.setdefault(kind, []).append(player)
    return groups or None


def _draw(played: "Result", path: Path) -> str:
    """Draw the picture if it can be drawn; return what to say of the files."""
    from collaborative_gym.tournaments.picture import draw_tournament

    try:
        draw_tournament(played, path)
    except ImportError as error:
        return f"wrote {path.parent}, but no picture: {error}"
    return f"wrote {path.parent}"
