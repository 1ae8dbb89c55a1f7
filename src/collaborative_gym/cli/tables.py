"""Tables that the command line prints."""

from collections.abc import Sequence
from itertools import zip_longest
from statistics import median

from rich.table import Table
from rich.text import Text

from collaborative_gym.certificate.report import (
    CERTIFICATE_NOTE,
    COLUMNS,
    Certificate,
    lines,
)
from collaborative_gym.cli.terminal import new_table
from collaborative_gym.comparisons.result import Comparison
from collaborative_gym.evaluation.report import (
    Report,
    Statistic,
    format_episodes,
    format_number,
    format_statistic,
    one_episode_notes,
    strain_lines,
)
from collaborative_gym.evaluation.speed import Benchmark, Rates
from collaborative_gym.evaluation.table11 import NOTE, Table11, column_names
from collaborative_gym.tournaments.result import (
    Tournament,
    format_estimate,
    format_measure,
    short_names,
)


def reports_table(reports: Sequence[Report]) -> Table:
    """Return what evaluations found, with 95 % intervals below the means."""
    columns = ("mean reward", "completion", "performance", "time to\nsuccess")
    has_score = any(len(report.sides) > 1 for report in reports)
    table = new_table("environment", *["score"] * has_score, *columns)
    for report in reports:
        for side, score in report.sides.items():
            own = "-" if score.score is None else _two_lines(score.score)
            median = f"\nmedian {format_number(score.mean_reward.median)}"
            table.add_row(
                _played(report) + (f"\n{side}" if len(report.sides) > 1 else ""),
                *[own] * has_score,
                _two_lines(score.mean_reward).append(median, "dim"),
                _two_lines(score.completion, percent=True),
                _two_lines(score.performance, percent=True),
                _two_lines(score.time_to_success, unit=" s"),
            )
    episodes = ", ".join(dict.fromkeys(str(len(report.episodes)) for report in reports))
    rates = [report.steps_per_second for report in reports]
    table.caption = (
        f"Means over {format_episodes(episodes)} and their 95 % intervals;"
        f" {_ends(rates)} steps per second."
    )
    table.caption = "\n".join([table.caption, *one_episode_notes(reports)])
    return table


def _played(report: Report) -> str:
    return report.title.replace(" with ", "\nwith ")


def strain_table(reports: Sequence[Report]) -> Table:
    """Return what arms did to one another, to things and to themselves."""
    table = new_table("environment", "strain", "mean", "worst", "in episode")
    table.columns[1].justify = "left"
    for report in reports:
        heads = _played(report).split("\n")
        for head, cells in zip_longest(heads, strain_lines(report), fillvalue=""):
            table.add_row(head, *cells)
    table.caption = "The greatest value in each episode; for the clearance, the least."
    return table


def table11_table(table11: Table11) -> Table:
    """Return the thesis's numbers beside ours, each environment's below its id."""
    names = (name.replace(" on ", " on\n") for name in column_names())
    table = new_table("environment", "thesis", *names)
    last = None
    for env_id, measure, *cells in table11.lines(reward_digits=1):
        if env_id != last:
            table.add_row(Text(env_id, "bold"))
            last = env_id
        texts = [Text(cell) for cell in cells]
        for text in texts:
            text.highlight_words(["PASS"], "green")
            text.highlight_words(["FAIL"], "bold red")
        table.add_row(f"  {measure}", *texts)
    table.caption = f"{table11.about()}\n{NOTE}"
    return table


def tournament_tables(tournament: Tournament) -> list[Table]:
    """Return the matrices of a tournament, how each player did, and kinds of runs."""
    measures = tournament.measures[: 1 if tournament.is_divided else None]
    tables = [_matrix_table(tournament, measure) for measure in measures]
    own = _rivals_table if tournament.is_divided else _partners_table
    tables.append(own(tournament))
    if tournament.group_means:
        table = new_table("training runs", "", "mean")
        table.columns[1].justify = "left"
        for kind, means in tournament.group_means.items():
            for i, (name, mean) in enumerate(means.items()):
                runs = f"{len(tournament.groups[kind])} of {kind}"
                table.add_row("" if i else runs, name, _measured(name, mean))
        table.caption = "Intervals over runs."
        tables.append(table)
    return tables


def _matrix_table(tournament: Tournament, measure: str) -> Table:
    names = short_names(tournament.players)
    first, *others = tournament.seats
    is_pair = len(others) == 1
    heading = f"{first} / {others[0]}" if is_pair else "one / all others"
    table = new_table(heading, *names.values())
    for row, entries in tournament.matrices[measure].items():
        cells = (_measured(measure, entry) for entry in entries.values())
        table.add_row(names[row], *cells)
    table.title, table.title_justify = measure, "left"
    return table


def _partners_table(tournament: Tournament) -> Table:
    names = short_names(tournament.players)
    table = new_table(
        "player", "measure", "self-play", "cross-play", "gap", *tournament.turns
    )
    table.columns[1].justify = "left"
    for name, standing in tournament.standings.items():
        worst = standing.worst and f"worst: {names[standing.worst]}"
        for label, measure in zip(
            (names[name], worst, ""), tournament.measures, strict=True
        ):
            means = standing.self_play, standing.gap, *standing.by_seat.values()
            own, gap, *seats = (
                format_measure(measure, each[measure].mean) for each in means
            )
            cross = _measured(measure, standing.cross_play[measure])
            who = Text(label or "", "dim" if label == worst else "")
            table.add_row(who, measure, own, cross, gap, *seats)
    table.caption = _tournament_caption(tournament)
    for seat, lists in tournament.conventions.items():
        listed = " | ".join(", ".join(map(names.__getitem__, own)) for own in lists)
        table.caption += f"\nGroups of partners that the same {seat} suits: {listed}."
    return table


def _rivals_table(tournament: Tournament) -> Table:
    names = short_names(tournament.players)
    columns = "rating", "wins", "draws", "losses", "points", "score"
    table = new_table("player", *columns, *tournament.turns)
    for name in sorted(tournament.players, key=lambda n: -tournament.ratings[n].mean):
        standing = tournament.standings[name]
        counts = standing.wins, standing.draws, standing.losses
        seats = (standing.by_seat[turn]["points"] for turn in tournament.turns)
        table.add_row(
            names[name],
            _measured("rating", tournament.ratings[name]),
            *map(str, counts),
            *(_measured(m, standing.cross_play[m]) for m in tournament.measures),
            *(format_measure("points", each.mean) for each in seats),
        )
    cycles = [" beats ".join(map(names.__getitem__, c)) for c in tournament.cycles]
    listed = "".join(f"\n{cycle} beats the first." for cycle in cycles)
    table.caption = _tournament_caption(tournament) + (listed or "\nNo cycles.")
    return table


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


def _measured(measure: str, statistic: Statistic) -> Text:
    """Return a mean, and its interval below."""
    mean, ends = _parted(format_estimate(measure.partition(" ")[0], statistic))
    return Text.assemble(mean, (f"\n{ends}" if ends else "", "dim"))


def comparison_tables(comparison: Comparison) -> list[Table]:
    """Return what came of a comparison of runs, with intervals below the numbers."""
    tables = []
    for title, heads, rows in comparison.tables():
        table = new_table(
            "\n".join(heads[:2]), *(h.replace(" (", "\n(") for h in heads[2:])
        )
        table.columns[0].no_wrap = False  # Settings can be long.
        for cells in rows:
            numbers = (_parted(cell) for cell in cells[2:])
            table.add_row(
                "\n".join(cells[:2]),
                *(Text.assemble(one, "\n", (rest, "dim")) for one, rest in numbers),
            )
        table.title, table.title_justify = title, "left"
        tables.append(table)
    return tables


def certificates_table(certificates: Sequence[Certificate]) -> Table:
    """Return how often each task was done while an arm was still."""
    heads = (name.replace(" for ", "\nfor ") for name in COLUMNS[2:])
    table = new_table("still arm", *heads)
    for certificate in certificates:
        table.add_row(Text(certificate.title, "bold"))
        for _, still, *cells in lines(certificate):
            table.add_row(f"  {still}", *(cell.replace(" of ", "/") for cell in cells))
    table.caption = CERTIFICATE_NOTE
    return table


def benchmark_table(benchmark: Benchmark) -> Table:
    """Return what was measured, one line per environment."""
    table = new_table(
        "environment",
        "expert\nbare, 1/s",
        "\nenv, 1/s",
        "\nratio",
        "random\nbare, 1/s",
        "\nenv, 1/s",
        "\nratio",
        "single\n1/s",
        "reset\nms",
        "make\ns",
        "world\nkB",
    )
    for speed in benchmark.environments:
        table.add_row(
            speed.environment,
            *_rates(speed.expert),
            *_rates(speed.random),
            f"{speed.single_rate:,.0f}",
            f"{speed.reset_ms:.2f}",
            f"{speed.make_s:.2f}",
            f"{speed.kb_per_env:.0f}",
        )
    machine, threads = benchmark.machine, benchmark.num_threads
    kept = [
        f"{median(each):.0%} ({min(each):.0%} at least)"
        for each in zip(
            *((s.expert.ratio, s.random.ratio) for s in benchmark.environments),
            strict=True,
        )
    ]
    table.caption = (
        f"Control steps per second (1/s); bare physics and environment with"
        f" {benchmark.num_envs} worlds on {threads}"
        f" {'thread' if threads == 1 else 'threads'}, with the expert's and with random"
        f" actions, which keep {kept[0]} and {kept[1]} of bare physics in the median;"
        " single: one PettingZoo environment.\n"
        f"{machine['cpu']}, {machine['cores']} cores,"
        f" Python {machine['python']}, MuJoCo {machine['mujoco']}"
    )
    return table


def _rates(rates: Rates) -> tuple[str, str, str]:
    return f"{rates.bare:,.0f}", f"{rates.env:,.0f}", f"{rates.ratio:.0%}"


def _two_lines(statistic: Statistic, percent: bool = False, unit: str = "") -> Text:
    mean, ends = _parted(format_statistic(statistic, percent=percent, unit=unit))
    return Text.assemble(mean, "\n", (ends, "dim"))


def _parted(told: str) -> tuple[str, str]:
    """Return a mean and its interval, told as "97 % (84 to 100)"; without it, ""."""
    mean, _, ends = told.rstrip(")").partition(" (")
    return mean, ends


def _ends(rates: Sequence[float]) -> str:
    """Return the least and the greatest rate, once if they read the same."""
    ends = min(rates), max(rates)
    return " to ".join(dict.fromkeys(f"{rate:,.0f}" for rate in ends))
