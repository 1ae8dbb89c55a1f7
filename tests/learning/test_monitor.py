import math
import resource
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("torch.utils.tensorboard", reason="needs the extra train")
pytest.importorskip("matplotlib", reason="needs the extra train")

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from collaborative_gym.evaluation.report import Score, Statistic
from collaborative_gym.files import SealedRows
from collaborative_gym.learning import curve, monitor
from collaborative_gym.learning.curve import draw_curve, learning_curve
from collaborative_gym.learning.monitor import Monitor, means_of, summarize
from collaborative_gym.learning.pool import Iteration


def episode(total, **others):
    return {
        "episode": 3,
        "seed": 0,
        "return": total,
        "completion": 1.0,
        "performance": 0.5,
        "time_to_success": math.nan,
        "length": 200,
        "diverged": False,
        "robot_1/return": total / 4,
        "robot_1/reach": total / 8,
        "robot_2/return": 3 * total / 4,
        **others,
    }


def row(steps, **others):
    return {"steps": steps, "return": -1.0 / steps, "robot_1/return": 0.1, **others}


@pytest.fixture
def start(tmp_path):
    """Return a function that starts a monitor of a run's folder, here or beneath."""
    started = []

    def start(rows=(), folder=tmp_path):
        started.append(Monitor(folder, "a run", rows))
        return started[-1]

    yield start
    for each in started:
        each.close()


def scalars(folder, tag):
    events = EventAccumulator(str(folder))
    events.Reload()
    return [(each.step, pytest.approx(each.value)) for each in events.Scalars(tag)]


def test_summary_has_means_over_episodes_and_what_learners_did():
    numbers = {"team": {"kl": np.float32(0.5), "learning_rate": 1e-3}}
    iteration = Iteration([episode(-4.0), episode(-8.0, completion=0.0)], numbers)
    assert summarize(8192, 2.0, 4096.0, iteration) == {
        "steps": 8192,
        "seconds": 2.0,
        "steps_per_second": 4096.0,
        "episodes": 2,
        "return": -6.0,
        "completion": 0.5,
        "performance": 0.5,
        "robot_1/return": -1.5,
        "robot_1/reach": -0.75,
        "robot_2/return": -4.5,
        "team/kl": 0.5,
        "team/learning_rate": 1e-3,
    }


def test_summary_leaves_out_what_is_not_known():
    summary = summarize(1, 1.0, 1.0, Iteration([], {}))
    assert summary.keys() == {"steps", "seconds", "steps_per_second", "episodes"}
    assert summary["episodes"] == 0


def test_summary_of_a_validation():
    statistics = [
        Statistic.of(each) for each in ([-3.0, -5.0], [1.0, 0.0], [0.25], [0.2], [])
    ]
    score = Score(*statistics)
    alone = SimpleNamespace(sides={"side_1": score})
    summary = summarize(1, 1.0, 1.0, Iteration([], {}), means_of(alone))
    assert summary["validation/return"] == -4.0
    assert summary["validation/completion"] == 0.5
    assert summary["validation/performance"] == 0.25
    assert "validation/score" not in summary
    score = replace(score, score=Statistic.of([2.0]))
    rivals = SimpleNamespace(sides={"side_1": score, "side_2": score})
    summary = summarize(1, 1.0, 1.0, Iteration([], {}), means_of(rivals))
    assert summary["validation/side_2/return"] == -4.0
    assert summary["validation/side_2/score"] == 2.0
    assert "validation/return" not in summary


def test_progress_reads_back_exactly(start, read_progress, tmp_path):
    rows = [
        row(8192, **{"team/kl": 0.1 + 0.2}),
        row(16384, **{"validation/return": -1e-17, "episodes": 41}),
        row(24576, **{"team/kl": math.inf}),
    ]
    monitor = start()
    for count, each in enumerate(rows, start=1):
        monitor.log(each)
        # What is logged is on the disk at once, whatever becomes of the run.
        assert read_progress(tmp_path) == rows[:count]
    assert monitor.rows == rows


def test_progress_stays_a_rectangle_where_columns_come_late(start, tmp_path):
    monitor = start()
    monitor.log({"steps": 1, "team/kl": 0.5})
    monitor.log(row(2, **{"team/kl": 0.25, "validation/return": -3.0}))
    monitor.log(row(3))
    lines = (tmp_path / "progress.csv").read_text().splitlines()
    assert [line.rpartition(",")[0] for line in lines] == [
        "steps,return,robot_1/return,team/kl,validation/return",
        "1,,,0.5,",
        "2,-0.5,0.1,0.25,-3.0",
        "3,-0.3333333333333333,0.1,,",
    ]


def test_numbers_become_plain(start, tmp_path):
    monitor = start()
    monitor.log({"steps": np.int64(5), "return": np.float64(0.25)})
    assert [type(value) for value in monitor.rows[0].values()] == [int, float]
    assert SealedRows.read(tmp_path / "progress.csv", "") == [
        {"steps": "5", "return": "0.25"}
    ]


def test_resumed_run_drops_what_came_after_its_checkpoint(
    start, read_progress, tmp_path
):
    monitor = start()
    for steps in (1, 2, 3, 4):
        monitor.log(row(steps, late=float(steps)))
    monitor.close()
    resumed = start(rows=monitor.rows[:2])
    assert read_progress(tmp_path) == monitor.rows[:2]
    resumed.log(row(3, late=30.0))
    assert read_progress(tmp_path) == resumed.rows
    assert scalars(tmp_path, "late") == [(1, 1.0), (2, 2.0), (3, 30.0)]


def test_run_resumed_before_its_first_row_hides_all(start, read_progress, tmp_path):
    monitor = start()
    monitor.log(row(1))
    monitor.close()
    start().log(row(2))
    assert [each["steps"] for each in read_progress(tmp_path)] == [2]
    assert scalars(tmp_path, "return") == [(2, -0.5)]


def test_full_disk_is_named_and_earlier_rows_stay(start, tmp_path):
    monitor = start()
    monitor.log(row(1))
    before = (tmp_path / "progress.csv").read_text()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    size = (tmp_path / "progress.csv").stat().st_size
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 3, hard))
    try:
        with pytest.raises(OSError, match=r"progress\.csv"):
            monitor.log(row(2))
        with pytest.raises(OSError, match=r"progress\.csv"):
            monitor.log(row(3, **{"validation/return": -3.0}))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / "progress.csv").read_text().startswith(before)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_full_disk_is_named_where_the_file_has_no_name(start, tmp_path):
    monitor = start()
    monitor.log(row(1))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    (events,) = tmp_path.glob("events.*")
    resource.setrlimit(resource.RLIMIT_FSIZE, (events.stat().st_size + 3, hard))
    try:
        for act in (lambda: monitor.log(row(2)), monitor.close):
            with pytest.raises(OSError, match=f"^cannot write {tmp_path}: File too l"):
                act()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        monitor._events.all_writers = None  # They would raise once more.


def test_folder_that_is_a_file_is_refused(start, tmp_path):
    (tmp_path / "run").write_text("")
    with pytest.raises(OSError, match=r"progress\.csv"):
        start(folder=tmp_path / "run")


@pytest.mark.parametrize(("cost", "expected"), [(0.0625, [1, 3, 5, 7]), (0.5, [1, 6])])
def test_curve_is_drawn_every_20_s_or_as_seldom_as_it_is_slow(
    start, monkeypatch, cost, expected
):
    drawn, now = [], [100.0]

    def draw(rows, title, path):
        drawn.append(len(rows))
        now[0] += cost

    monkeypatch.setattr(monitor, "draw_curve", draw)
    monkeypatch.setattr(monitor.time, "monotonic", lambda: now[0])
    run = start()
    for steps in range(1, 9):
        run.log(row(steps))
        now[0] += 11.0
    assert drawn == expected
    run.close()
    assert drawn == [*expected, 8]


def test_curve_shows_all_robots_each_robot_and_validations():
    rows = [
        row(1_000_000, **{"robot_2/return": 1.0}),
        row(2_000_000, completion=0.5, **{"validation/return": 3.0}),
    ]
    above, below = learning_curve(rows, "a run").axes
    lines = {line.get_label(): line for line in above.lines + below.lines}
    named = [name for name in lines if not name.startswith("_")]
    assert named == [
        "all robots",
        "all robots, validation",
        "robot_1",
        "robot_2",
        "completion",
    ]
    assert lines["all robots"].get_xdata() == pytest.approx([1.0, 2.0])
    assert lines["all robots"].get_ydata() == pytest.approx([-1e-6, -5e-7])
    assert lines["robot_2"].get_xdata() == pytest.approx([1.0])
    assert lines["all robots, validation"].get_ydata() == pytest.approx([3.0])
    assert lines["completion"].get_ydata() == pytest.approx([50.0])


def test_curve_is_smoothed_over_two_percent_of_the_run():
    values = np.array([0.0, 0.0, 3.0, 0.0, 0.0])
    assert curve._moving_mean(values, 1) == pytest.approx(values)
    assert curve._moving_mean(values, 3) == pytest.approx([0.0, 1.0, 1.0, 1.0, 0.0])
    assert curve._moving_mean(values, 5)[[0, -1]] == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("count", [0, 1, 3])
def test_curve_is_a_picture_of_eight_by_six_inches(tmp_path, count):
    rows = [row(steps, completion=math.nan) for steps in range(1, count + 1)]
    draw_curve(rows, "a run", tmp_path / "curve.png")
    head = (tmp_path / "curve.png").read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = (int.from_bytes(head[i : i + 4]) for i in (16, 20))
    assert (width, height) == (1200, 900)
    assert [path.name for path in tmp_path.iterdir()] == ["curve.png"]


def test_missing_extra_is_said_before_the_run(start, tmp_path, monkeypatch):
    monkeypatch.setattr(monitor, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"pip install .* --editable .\.\[train\]"):
        start()
    assert not list(tmp_path.iterdir())
