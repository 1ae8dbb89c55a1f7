"""Results of trying a task with one arm still or blindly, as values, JSON, Markdown."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from collaborative_gym.errors import check_count, check_number, shown
from collaborative_gym.evaluation.table import escaped, markdown_table
from collaborative_gym.files import read_sealed, sealed
from collaborative_gym.tasks.identity import Identity

PLAYERS = {
    "expert": "expert",
    "blind": "one motion for all",
    "search": "a motion for each",
    "replay": "a recorded episode",
    "ppo": "trained",
}
"""Players against a still arm, and their names in the table."""

TEAM = "team", "blind", 0.0
"""In place of a still arm: the whole team plays, and observes nothing."""

_FORMAT = 1  # number of the file format; others are refused

_CONFIDENCE = 0.95


@dataclass(frozen=True)
class Trial:
    """One player against one still arm."""

    passive: str  # agent whose arm is still
    partner: str  # its policy: idle, gripping or frozen
    fraction: float  # share of the expert's time to the goal at which it froze
    player: str  # who commands the other arms, one of `PLAYERS`
    episodes: int  # number of starts
    completed: int  # number of starts from which the goal was reached
    nearest: float  # median of the least `Task.shortfall` of each episode
    converged: bool | None = None  # the search for a motion; None without a search

    @property
    def row(self) -> tuple[str, str, float]:
        """The still arm: agent, policy and fraction."""
        return self.passive, self.partner, self.fraction

    @property
    def still(self) -> str:
        """The still arm in words, such as "robot_1 frozen at 50 %"; or the team."""
        if self.row == TEAM:
            return "none: the team is blind"
        at = f" at {100 * self.fraction:.0f} %" if self.fraction else ""
        return f"{self.passive} {self.partner}{at}"

    @property
    def count(self) -> str:
        """Number of completed episodes, such as "0 of 500"."""
        return f"{self.completed} of {self.episodes}"

    @property
    def title(self) -> str:
        """The result in words."""
        return f"{self.still}, {PLAYERS[self.player]}: {self.count}"

    @property
    def completion(self) -> float:
        """Share of the episodes in which the goal was reached, 0 to 1."""
        return self.completed / self.episodes

    @property
    def bound(self) -> float:
        """Upper bound of the completion, with 95 % confidence (Clopper-Pearson)."""
        return upper_bound(self.completed, self.episodes)


def upper_bound(completed: int, episodes: int) -> float:
    """Return the exact one-sided bound of Clopper and Pearson, with 95 % confidence.

    For no completion in n episodes it is nearly 3 / n.
    """
    if completed >= episodes:
        return 1.0
    low, high = completed / episodes, 1.0
    for _ in range(60):
        share = (low + high) / 2
        is_too_high = _binomial(completed, episodes, share) < 1.0 - _CONFIDENCE
        low, high = (low, share) if is_too_high else (share, high)
    return high


def _binomial(most: int, episodes: int, share: float) -> float:
    """Return the probability that at most so many of the episodes are completed."""
    yes, no = math.log(share), math.log1p(-share)
    whole = math.lgamma(episodes + 1)

    def log_of(k: int) -> float:
        left = episodes - k
        return whole - math.lgamma(k + 1) - math.lgamma(left + 1) + k * yes + left * no

    return sum(math.exp(log_of(k)) for k in range(most + 1))


def _success(trial: Trial) -> tuple[float, int]:
    """Return what is greatest in the best trial; among equals, in the surest."""
    return trial.completion, trial.episodes


@dataclass(frozen=True)
class Certificate:
    """Results of trials to do a task while one arm is still, in the order of the work.

    `settings` has the `identity` of the task, the `budget` and the `seed`.
    """

    environment: str
    settings: dict[str, Any]
    trials: tuple[Trial, ...] = ()

    @property
    def title(self) -> str:
        """The environment and its arms."""
        return Identity.from_dict(self.settings["identity"]).title

    @property
    def rows(self) -> dict[tuple[str, str, float], tuple[Trial, ...]]:
        """The trials of each still arm."""
        found: dict[tuple[str, str, float], tuple[Trial, ...]] = {}
        for trial in self.trials:
            found[trial.row] = (*found.get(trial.row, ()), trial)
        return found

    @property
    def best(self) -> dict[tuple[str, str, float], Trial]:
        """The best trial against each still arm."""
        return {row: max(trials, key=_success) for row, trials in self.rows.items()}

    @property
    def statement(self) -> str:
        """The results in one sentence."""
        found = []
        of_arms = [trial for trial in self.trials if trial.row != TEAM]
        for fraction in sorted({trial.fraction for trial in of_arms}):
            trials = [trial for trial in of_arms if trial.fraction == fraction]
            # A motion that was searched for a start is tried on few of them.
            judged = [each for each in trials if each.player != "search"] or trials
            most, of_all = (max(own, key=_success) for own in (judged, trials))
            since = f"{100 * fraction:.0f} % of the way" if fraction else "the start"
            by = f"{most.still}, " * (most.completed > 0)
            said = f"while one arm is still from {since} on, the others complete"
            said += f" {most.count} starts ({by}up to {100 * most.bound:.1f} %)"
            if of_all.completion > most.completion:
                said += f", and {of_all.count} by a motion searched for each"
            found.append(said)
        if blind := self.best.get(TEAM):
            said = f"a team that observes nothing completes {blind.count}"
            found.append(f"{said} (up to {100 * blind.bound:.1f} %)")
        return f"{self.title}: {'; '.join(found)}"

    def to_json(self) -> str:
        """Return everything as JSON."""
        return sealed({"format": _FORMAT, **asdict(self)})

    @classmethod
    def load(cls, path: Path) -> "Certificate":
        """Return the certificate of a file.

        Raises:
          OSError: if it cannot be read.
          ValueError: if it is damaged or of another format.
        """
        content = read_sealed(path, "remove it to start again")
        try:
            if content["format"] != _FORMAT:
                raise ValueError(f"its format is {content['format']}, not {_FORMAT}")
            Identity.from_dict(content["settings"]["identity"])
            trials = tuple(map(_checked, content["trials"]))
            return cls(str(content["environment"]), content["settings"], trials)
        except (LookupError, TypeError, ValueError) as error:
            reason = str(error).partition("\n")[0]
            raise ValueError(
                f"{path} is not a certificate: {reason}; remove it to start again"
            ) from error

    def to_markdown(self) -> str:
        """Return a Markdown table, one line for each still arm."""
        return certificates_to_markdown([self])


def _checked(content: dict[str, Any]) -> Trial:
    trial = Trial(**content)
    check_count("episodes", trial.episodes, 1)
    check_count("completed", trial.completed, 0, trial.episodes)
    check_number("nearest", trial.nearest)
    check_number("fraction", trial.fraction, at_least=0.0, at_most=1.0)
    if trial.player not in PLAYERS:
        raise ValueError(f"there is no player {shown(trial.player)}")
    return trial


CERTIFICATE_NOTE = (
    "The table counts how often the goal was reached while one arm was still; its"
    ' columns name what commanded the other arms. "Up to" is the one-sided upper 95 %'
    ' bound for the best of them, and "nearest" the least median distance from the'
    ' goal. "A motion for each" was searched for on the start on which it is played. A'
    " blind team plays one motion, or the best of some recorded episodes, from every"
    " start. † marks a search that spent its rounds before it converged."
)
"""Note above the table."""

COLUMNS = ("environment", "still arm", *PLAYERS.values(), "up to", "nearest")
"""Columns of the table, which has a line for each still arm."""


def lines(certificate: Certificate) -> list[tuple[str, ...]]:
    """Return the cells of `COLUMNS`, one tuple for each still arm."""
    found = []
    for row, trials in certificate.rows.items():
        counts = {t.player: t.count + "†" * (t.converged is False) for t in trials}
        best, nearest = certificate.best[row], min(trial.nearest for trial in trials)
        cells = (counts.get(player, "-") for player in PLAYERS)
        ends = f"{100 * best.bound:.1f} %", f"{nearest:.2f}"
        found.append((certificate.title, best.still, *cells, *ends))
    return found


def certificates_to_markdown(certificates: Sequence[Certificate]) -> str:
    """Return a Markdown section for each certificate: its statement and its table."""
    parts = [CERTIFICATE_NOTE]
    for each in certificates:
        rows = [cells for _, *cells in lines(each)]
        table = markdown_table(COLUMNS[1:], rows, words=1)
        parts += [f"## {each.title}", escaped(each.statement), table]
    return "\n\n".join(parts) + "\n"
