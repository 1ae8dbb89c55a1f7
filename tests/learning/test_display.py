import io

import pytest
from rich.console import Console

from collaborative_gym.learning import display
from collaborative_gym.learning.display import Display

TITLE = "LiftTaskSawyers-v0 [a run]"


def row(steps, seconds=None, **others):
    seconds = steps / 1000 if seconds is None else seconds
    return {"steps": steps, "seconds": seconds, "steps_per_second": 800.0, **others}


FULL = {
    "return": -1018.34,
    "completion": 0.25,
    "performance": 0.125,
    "robot_1/return": -518.3,
    "robot_1/reach": -207.3,
    "robot_1/handover": -311.0,
    "robot_2/return": -500.04,
    "robot_2/reach": -166.4,
    "team/kl": 0.0352,
    "team/learning_rate": 4e-4,
}


@pytest.fixture
def clock(monkeypatch):
    """Return the time that the display reads, which the test sets."""
    now = [0.0]
    monkeypatch.setattr(display.time, "monotonic", lambda: now[0])
    return now


def console(is_terminal, width=80, kind="xterm"):
    return Console(
        file=io.StringIO(),
        force_terminal=is_terminal,
        width=width,
        color_system=None,
        _environ={"TERM": kind},
    )


def panel(*rows, best=None, total=2_000_000, width=80):
    """Return the lines of the panel after these rows."""
    terminal = console(True, width)
    with Display(TITLE, total, terminal) as shown:
        for each in rows:
            shown.show(each, best)
    text = terminal.file.getvalue()
    return text[text.rindex("╭") :].splitlines()


def cells(lines, name):
    """Return what stands in the line of a table, after its name."""
    (line,) = (line for line in lines if f" {name} " in line)
    return line.partition(f" {name} ")[2].strip("│ ").split()


def test_panel_shows_pace_and_time_left():
    lines = panel(row(400_000), row(500_000))
    assert TITLE in lines[0]
    # 1,000 steps/s since the first row, whatever the last iteration's rate was.
    assert lines[2].strip("│ ") == (
        "0.50 M of 2.00 M steps (25 %), 800 steps/s, 25 min 00 s left"
    )


def test_time_left_of_a_run_that_goes_on_is_by_its_present_speed():
    lines = panel(row(1_000_000, 9000.0), row(1_100_000, 9010.0))
    assert lines[2].strip("│ ").endswith("1 min 30 s left")
    assert panel(row(1_200_000))[2].strip("│ ").endswith("16 min 40 s left")


def test_panel_ends_with_the_time_that_it_took():
    lines = panel(row(2_000_100, 7265.0))
    assert lines[2].strip("│ ").endswith("(100 %), 800 steps/s, took 2 h 01 min")


def test_panel_shows_training_and_validations():
    validation = {"validation/return": -900.0, "validation/completion": 0.5}
    best = {"steps": 7, "validation/return": -640.04, "validation/completion": 1.0}
    lines = panel(row(1000, **FULL), row(2000, **validation), row(3000), best=best)
    assert cells(lines, "return")[:3] == ["-1,018.3", "-900.0", "-640.0"]
    assert cells(lines, "completion")[:6] == ["25", "%", "50", "%", "100", "%"]
    assert cells(lines, "performance")[:4] == ["12", "%", "-", "-"]


def test_panel_shows_rewards_by_robot_and_updates_by_learner():
    lines = panel(row(1000, **FULL))
    assert cells(lines, "reward") == ["robot_1", "robot_2"]
    assert cells(lines, "reach") == ["-207.3", "-166.4"]
    assert cells(lines, "handover") == ["-311.0"]
    assert cells(lines, "KL")[0] == "0.0352"
    assert cells(lines, "learning rate")[0] == "4.0e-04"


def test_learners_named_after_robots_are_not_taken_for_rewards():
    numbers = {"robot_1/kl": 0.01, "robot_2/kl": 0.02, "robot_1/weight_norm": 9.0}
    numbers |= {"robot_1/learning_rate": 1e-3, "robot_2/learning_rate": 1e-3}
    lines = panel(row(1000, **FULL) | numbers)
    assert sum("KL" in line or "kl" in line for line in lines) == 1
    assert cells(lines, "weight norm") == ["9.0"]


@pytest.mark.parametrize("robots", [2, 3, 6])
@pytest.mark.parametrize("width", [80, 100, 200])
def test_panel_fits_and_cuts_no_number(robots, width):
    rewards = {f"robot_{i + 1}/return": -1234.5 for i in range(robots)}
    lines = panel(row(1000, **FULL) | rewards, width=width)
    assert {len(line) for line in lines[:-1]} == {min(width, 100)}
    assert sum(line.count("-1,234.5") for line in lines) == robots
    assert "…" not in "".join(lines[3:])


@pytest.mark.parametrize("output", [console(False), console(True, kind="dumb")])
def test_elsewhere_than_on_a_terminal_lines_come_now_and_then(clock, output):
    with Display(TITLE, 2_000_000, output) as shown:
        for second in range(0, 100, 10):
            clock[0] = float(second)
            shown.show(row(1000 * (second + 10), **FULL))
    lines = output.file.getvalue().splitlines()
    assert [line.split(", ")[1] for line in lines] == [
        "10,000 of 2.00 M steps (0 %)",
        "40,000 of 2.00 M steps (2 %)",
        "70,000 of 2.00 M steps (4 %)",
        "0.10 M of 2.00 M steps (5 %)",
    ]
    assert lines[0].endswith("return -1,018.3, completion 25 %, performance 12 %")


def test_line_at_each_validation_and_none_twice(clock):
    output = console(False)
    with Display(TITLE, 2_000_000, output) as shown:
        shown.show(row(1000))
        shown.show(row(2000))
        shown.show(row(3000, **{"validation/return": -4.0}))
    first, last = output.file.getvalue().splitlines()
    assert "validation" not in first
    assert last.startswith(f"{TITLE}, 3,000 of")
    assert last.endswith(", validation return -4.0")


def test_no_row_shows_nothing():
    output = console(False)
    with Display(TITLE, 2_000_000, output):
        pass
    assert output.file.getvalue() == ""
