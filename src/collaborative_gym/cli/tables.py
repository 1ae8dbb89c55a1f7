"""Tables that the command line prints."""

from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from statistics import median

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import Markdown, TableElement
from rich.table import Table
from rich.text import Text

from collaborative_gym.certificate.report import (
    CERTIFICATE_NOTE,
    COLUMNS,
    Certificate,
    lines,
)
from collaborative_gym.cli.terminal import fitted, new_table
from collaborative_gym.comparisons.result import Comparison
from collaborative_gym.evaluation.report import (
    Report,
    Statistic,
    coordination_lines,
    format_episodes,
    format_number,
    format_statistic,
    one_episode_notes,
    strain_lines,
)
from collaborative_gym.evaluation.speed import Benchmark
from collaborative_gym.evaluation.table11 import NOTE, Table11, column_names
from collaborative_gym.tournaments.result import (
    Tournament,
    format_estimate,
    format_measure,
    short_names,
)


class _PageTable(TableElement):
    """A table of a page, which cuts off nothing."""

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        # Its edges take a column on each side.
        for table in super().__rich_console__(console, options):
            if isinstance(table, Table):
                yield fitted(table, options.max_width - 2)


class Page(Markdown):
    """A page whose tables fit."""

    elements = Markdown.elements | {"table_open": _PageTable}


def reports_table(reports: Sequence[Report], title: str | None = None) -> Table:
    """Return the results of evaluations, with 95 % intervals below the means."""
    has_score = any(len(report.sides) > 1 for report in reports)
    heads = ["environment", *["score"] * has_score, "mean reward", "completion"]
    rows = []
    for report in reports:
        for side, score in report.sides.items():
            own = "-" if score.score is None else _two_lines(score.score)
            median = f"\nmedian {format_number(score.mean_reward.median)}"
            rows.append(
                [
                    _played(report) + (f"\n{side}" if len(report.sides) > 1 else ""),
                    *[own] * has_score,
                    _two_lines(score.mean_reward).append(median, "dim"),
                    _two_lines(score.completion, percent=True),
                    _two_lines(score.performance, percent=True),
                    _two_lines(score.at_goal, percent=True),
                    _two_lines(score.time_to_success, unit=" s"),
                ]
            )
    episodes = ", ".join(dict.fromkeys(str(len(report.episodes)) for report in reports))
    rates = [report.steps_per_second for report in reports]
    # Least and greatest, once if they read the same.
    ends = dict.fromkeys(f"{rate:,.0f}" for rate in (min(rates), max(rates)))
    own = " and their 95 % intervals" * (episodes != "1")
    means = (
        f"Means over {format_episodes(episodes)}{own};"
        f" {' to '.join(ends)} steps per second."
    )
    return new_table(
        [*heads, "performance", "at goal", "time to\nsuccess"],
        rows,
        title=title,
        caption="\n".join([means, *one_episode_notes(reports)]),
    )


def _played(report: Report) -> str:
    return report.title.replace(" with ", "\nwith ")


def coordination_table(reports: Sequence[Report]) -> Table:
    """Return how arms work together in the tasks that say how to measure it."""
    heads = ["environment", "coordination", "mean", "median"]
    return _listed(heads, reports, coordination_lines)


def strain_table(reports: Sequence[Report]) -> Table:
    """Return the strain: of arms on one another, on things and on themselves."""
    heads = ["environment", "strain", "mean", "worst", "in episode"]
    caption = (
        "Greatest value in each episode (clearance: least); rows that are zero are left"
        " out. Torque and speed over limit are multiples of the limit."
    )

    def more_than_nothing(report: Report) -> list[list[str]]:
        lines = zip(strain_lines(report), report.strain.values(), strict=True)
        return [line for line, each in lines if each.worst]

    return _listed(heads, reports, more_than_nothing, caption)


def _listed(
    heads: Sequence[str],
    reports: Sequence[Report],
    lines_of: Callable[[Report], list[list[str]]],
    caption: str | None = None,
) -> Table:
    rows = [
        [head, *(cells or ())[: len(heads) - 1]]
        for report in reports
        for head, cells in zip_longest(
            _played(report).split("\n"), lines_of(report), fillvalue=""
        )
    ]
    return new_table(heads, rows, words=2, caption=caption)


def table11_table(table11: Table11) -> Table:
    """Return the thesis's numbers beside ours, each environment's below its id."""
    heads = (name.replace(" on ", " on\n") for name in column_names())
    rows, last = [], None
    for env_id, measure, *cells in table11.lines(reward_digits=1):
        if env_id != last:
            rows.append([Text(env_id, "bold")])
            last = env_id
        texts = [Text(cell) for cell in cells]
        for text in texts:
            text.highlight_words(["PASS"], "green")
            text.highlight_words(["FAIL"], "bold red")
        rows.append([f"  {measure}", *texts])
    caption = f"{table11.about()}\n{NOTE}"
    return new_table(["environment", "thesis", *heads], rows, caption=caption)


def tournament_tables(tournament: Tournament) -> list[Table]:
    """Return the matrices of a tournament, each player's results, and kinds of runs."""
    names, tables = short_names(tournament.players), []
    for measure in tournament.measures[: 1 if tournament.is_divided else None]:
        first, *others = tournament.seats
        is_pair = len(others) == 1
        heading = f"{first} / {others[0]}" if is_pair else "one / all others"
        rows = [
            [names[row], *(_measured(measure, entry) for entry in entries.values())]
            for row, entries in tournament.matrices[measure].items()
        ]
        tables.append(new_table([heading, *names.values()], rows, title=measure))
    own = _rivals_table if tournament.is_divided else _partners_table
    tables.append(own(tournament, names))
    if tournament.group_means:
        rows = []
        for kind, means in tournament.group_means.items():
            runs = [f"{len(tournament.groups[kind])} of {kind}"]
            for name, mean in means.items():
                rows.append([runs.pop() if runs else "", name, _measured(name, mean)])
        heads = ["training runs", "", "mean"]
        tables.append(new_table(heads, rows, words=2, caption="Intervals over runs."))
    return tables


def _partners_table(tournament: Tournament, names: Mapping[str, str]) -> Table:
    rows = []
    for name, standing in tournament.standings.items():
        worst = standing.worst and f"worst: {names[standing.worst]}"
        labels = names[name], worst, ""
        for label, measure in zip(labels, tournament.measures, strict=True):
            means = standing.self_play, standing.gap, *standing.by_seat.values()
            own, gap, *seats = (format_measure(measure, m[measure].mean) for m in means)
            cross = _measured(measure, standing.cross_play[measure])
            who = Text(label or "", "dim" if label == worst else "")
            rows.append([who, measure, own, cross, gap, *seats])
    caption = _tournament_caption(tournament)
    for seat, lists in tournament.conventions.items():
        listed = " | ".join(", ".join(map(names.__getitem__, own)) for own in lists)
        caption += f"\nGroups of partners with which one {seat} plays well: {listed}."
    heads = ["player", "measure", "self-play", "cross-play", "gap", *tournament.turns]
    return new_table(heads, rows, words=2, caption=caption)


def _rivals_table(tournament: Tournament, names: Mapping[str, str]) -> Table:
    rows = []
    for name in sorted(tournament.players, key=lambda n: -tournament.ratings[n].mean):
        standing = tournament.standings[name]
        counts = standing.wins, standing.draws, standing.losses
        seats = (standing.by_seat[turn]["points"] for turn in tournament.turns)
        rows.append(
            [
                names[name],
                _measured("rating", tournament.ratings[name]),
                *map(str, counts),
                *(_measured(m, standing.cross_play[m]) for m in tournament.measures),
                *(format_measure("points", each.mean) for each in seats),
            ]
        )
    cycles = [" beats ".join(map(names.__getitem__, c)) for c in tournament.cycles]
    listed = "".join(f"\n{cycle} beats the first." for cycle in cycles)
    caption = _tournament_caption(tournament) + (listed or "\nNo cycles.")
    columns = "rating", "wins", "draws", "losses", "points", "score"
    return new_table(["player", *columns, *tournament.turns], rows, caption=caption)


def _tournament_caption(tournament: Tournament) -> str:
    episodes = tournament.settings["episodes"]
    lines = [f"{format_episodes(episodes)} for each pairing, of the same starts."]
    if tournament.is_one_episode:
        lines = ["All starts are alike: one deterministic episode, no intervals."]
    lines[0] = f"{tournament.title}. {lines[0]}"
    diverged = sum(sum(each.columns["diverged"]) for each in tournament.pairings)
    if diverged:
        lines.append(f"{diverged:.0f} episodes diverged.")
    lines += [f"{title} left out: {why}" for title, why in tournament.left_out.items()]
    return "\n".join(lines)


def comparison_tables(comparison: Comparison) -> list[Table]:
    """Return the results of a comparison of runs, with intervals below the numbers."""
    tables = []
    for title, heads, found in comparison.tables():
        rows = [["\n".join(cells[:2]), *map(_stacked, cells[2:])] for cells in found]
        heads = ["\n".join(heads[:2]), *(h.replace(" (", "\n(") for h in heads[2:])]
        tables.append(new_table(heads, rows, title=title))
        tables[-1].columns[0].no_wrap = False  # Settings can be long.
    return tables


def certificates_table(certificates: Sequence[Certificate]) -> Table:
    """Return how often each task was done while an arm was still."""
    rows = []
    for certificate in certificates:
        rows.append([Text(certificate.title, "bold")])
        for _, still, *cells in lines(certificate):
            rows.append([f"  {still}", *(cell.replace(" of ", "/") for cell in cells)])
    heads = (name.replace(" for ", "\nfor ") for name in COLUMNS[2:])
    return new_table(["still arm", *heads], rows, caption=CERTIFICATE_NOTE)


def benchmark_table(benchmark: Benchmark) -> Table:
    """Return the speeds, one line per environment."""
    rows, kept = [], []
    for speed in benchmark.environments:
        kept.append((speed.expert.ratio, speed.random.ratio))
        makes = "\n".join(f"{seconds:.2f}" for seconds in speed.make_s)
        single = f"{speed.single_rate:,.0f}", f"{speed.reset_ms:.2f}", makes
        rows.append([speed.environment, *[""] * 3, *single, f"{speed.kb_per_env:.0f}"])
        for who, rates in (("expert", speed.expert), ("random", speed.random)):
            per_second = f"{rates.bare:,.0f}", f"{rates.env:,.0f}"
            rows.append([f"  {who}", *per_second, f"{rates.ratio:.0%}"])
    expert, random = (
        f"{median(each):.0%}" + f" ({min(each):.0%} at least)" * (len(each) > 1)
        for each in zip(*kept, strict=True)
    )
    machine, threads = benchmark.machine, benchmark.num_threads
    in_median = ", in the median" * (len(benchmark.environments) > 1)
    heads = "bare\n1/s", "env\n1/s", "\nratio", "single\n1/s", "reset\nms", "make\ns"
    return new_table(
        ["environment", *heads, "world\nkB"],
        rows,
        caption=f"Control steps per second (1/s) with {benchmark.num_envs} worlds on"
        f" {threads} {'thread' if threads == 1 else 'threads'}: of bare physics, and of"
        f" the environment, which keeps {expert} with the expert's actions and"
        f" {random} with random ones{in_median}; single: one PettingZoo"
        " environment; make: the first of a process, and the second.\n"
        f"{machine['cpu']}, {machine['cores']} cores,"
        f" Python {machine['python']}, MuJoCo {machine['mujoco']}",
    )


def _measured(measure: str, statistic: Statistic) -> Text:
    return _stacked(format_estimate(measure.partition(" ")[0], statistic))


def _two_lines(statistic: Statistic, percent: bool = False, unit: str = "") -> Text:
    return _stacked(format_statistic(statistic, percent=percent, unit=unit))


def _stacked(cell: str) -> Text:
    mean, _, ends = cell.rstrip(")").partition(" (")
    return Text.assemble(mean, (f"\n{ends}" if ends else "", "dim"))
