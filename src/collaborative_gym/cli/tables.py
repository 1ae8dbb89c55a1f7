"""Tables that the command line prints."""

from collections.abc import Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from collaborative_gym.certificate.report import (
    CERTIFICATE_NOTE,
    COLUMNS,
    Certificate,
    lines,
)
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.evaluation.report import (
    Report,
    Statistic,
    format_number,
    format_statistic,
    one_episode_notes,
    strain_lines,
)
from collaborative_gym.evaluation.speed import Benchmark
from collaborative_gym.evaluation.table11 import NOTE, Table11, column_names
from collaborative_gym.policies.policy import BASELINES
from collaborative_gym.tasks.registry import get_env, list_envs, make_task


def environments_table(with_sizes: bool) -> Table:
    """Return ids, tasks and robots of all environments, one line each."""
    sizes = ["observation", "action"] if with_sizes else []
    table = _table("environment", "task", "robots", "baseline", *sizes)
    for column in table.columns[1:4]:
        column.justify = "left"
    for env_id in list_envs():
        spec = get_env(env_id)
        has_baseline = (BASELINES / f"{env_id}.safetensors").exists()
        table.add_row(
            env_id,
            spec.task.__name__,
            ", ".join(spec.robots),
            "yes" if has_baseline else "-",
            *(_sizes(env_id) if with_sizes else ()),
        )
    return table


def _sizes(env_id: str) -> list[str]:
    """Return the sizes of each agent's observation and action; it needs a world."""
    env = VectorEnv(make_task(env_id), 1, num_threads=1)
    return [
        ", ".join(str(space.shape[0]) for space in spaces.values())
        for spaces in (env.single_observation_spaces, env.single_action_spaces)
    ]


def reports_table(reports: Sequence[Report]) -> Table:
    """Return what evaluations found, with 95 % intervals below the means."""
    columns = ("mean reward", "completion", "performance", "time to\nsuccess")
    has_score = any(len(report.sides) > 1 for report in reports)
    table = _table("environment", *["score"] * has_score, *columns)
    for report in reports:
        for side, score in report.sides.items():
            own = "-" if score.score is None else _two_lines(score.score)
            median = f"\nmedian {format_number(score.mean_reward.median)}"
            table.add_row(
                report.environment + (f"\n{side}" if len(report.sides) > 1 else ""),
                *[own] * has_score,
                _two_lines(score.mean_reward).append(median, "dim"),
                _two_lines(score.completion, percent=True),
                _two_lines(score.performance, percent=True),
                _two_lines(score.time_to_success, unit=" s"),
            )
    episodes = ", ".join(dict.fromkeys(str(len(report.episodes)) for report in reports))
    rates = [report.steps_per_second for report in reports]
    table.caption = (
        f"Means over {episodes} episodes and their 95 % intervals;"
        f" {_ends(rates)} steps per second."
    )
    table.caption = "\n".join([table.caption, *one_episode_notes(reports)])
    return table


def strain_table(reports: Sequence[Report]) -> Table:
    """Return what arms did to one another, to things and to themselves."""
    table = _table("environment", "strain", "mean", "worst", "in episode")
    table.columns[1].justify = "left"
    for report in reports:
        for i, cells in enumerate(strain_lines(report)):
            table.add_row("" if i else report.environment, *cells)
    table.caption = "Of each episode the greatest, and the least clearance."
    return table


def table11_table(table11: Table11) -> Table:
    """Return the thesis's numbers beside ours, each environment's below its id."""
    names = (name.replace(" on ", " on\n") for name in column_names())
    table = _table("environment", "thesis", *names)
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


def certificates_table(certificates: Sequence[Certificate]) -> Table:
    """Return how often each task was done while an arm was still."""
    heads = (name.replace(" for ", "\nfor ") for name in COLUMNS[2:])
    table = _table("still arm", *heads)
    for certificate in certificates:
        table.add_row(Text(certificate.environment, "bold"))
        for _, still, *cells in lines(certificate):
            table.add_row(f"  {still}", *(cell.replace(" of ", "/") for cell in cells))
    table.caption = CERTIFICATE_NOTE
    return table


def benchmark_table(benchmark: Benchmark) -> Table:
    """Return what was measured, one line per environment."""
    table = _table(
        "environment",
        "bare\n1/s",
        "env\n1/s",
        "ratio\n",
        "single\n1/s",
        "reset\nms",
        "make\ns",
        "world\nkB",
    )
    for speed in benchmark.environments:
        table.add_row(
            speed.environment,
            f"{speed.bare_rate:,.0f}",
            f"{speed.env_rate:,.0f}",
            f"{speed.ratio:.0%}",
            f"{speed.single_rate:,.0f}",
            f"{speed.reset_ms:.2f}",
            f"{speed.make_s:.2f}",
            f"{speed.kb_per_env:.0f}",
        )
    machine, threads = benchmark.machine, benchmark.num_threads
    rates = [speed.rate_per_core for speed in benchmark.environments]
    table.caption = (
        f"Control steps per second (1/s); bare physics and environment with"
        f" {benchmark.num_envs} worlds on {threads}"
        f" {'thread' if threads == 1 else 'threads'}, the environment"
        f" {_ends(rates)} per core; single: one PettingZoo environment.\n"
        f"{machine['cpu']}, {machine['cores']} cores,"
        f" Python {machine['python']}, MuJoCo {machine['mujoco']}"
    )
    return table


def _table(first: str, *others: str) -> Table:
    """Return an empty table, text in its first column and numbers in the others."""
    table = Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        collapse_padding=True,
        caption_justify="left",
    )
    table.add_column(first, no_wrap=True)
    for name in others:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _two_lines(statistic: Statistic, percent: bool = False, unit: str = "") -> Text:
    mean, _, interval = format_statistic(
        statistic, percent=percent, unit=unit
    ).partition(" (")
    return Text.assemble(mean, "\n", (interval.rstrip(")"), "dim"))


def _ends(rates: Sequence[float]) -> str:
    """Return the least and the greatest rate, once if they read the same."""
    ends = min(rates), max(rates)
    return " to ".join(dict.fromkeys(f"{rate:,.0f}" for rate in ends))
