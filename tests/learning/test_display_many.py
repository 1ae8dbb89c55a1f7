import io

from rich.console import Console

from collaborative_gym.learning.display import ManyDisplay

TOTALS = dict.fromkeys(("one", "two", "three"), 1_000_000)


def shown(is_terminal):
    console = Console(
        file=io.StringIO(),
        force_terminal=is_terminal,
        width=80,
        color_system=None,
        _environ={"TERM": "xterm"},
    )
    row = {"steps": 250_000, "steps_per_second": 1000.0, "return": -12.5}
    with ManyDisplay(TOTALS, console) as display:
        display.show("two", row | {"completion": 0.25})
        display.show("three", {"steps": 1_000_000, "validation/completion": 1.0})
    return console.file.getvalue()


def test_one_table_has_a_line_for_each_run_those_under_way_first():
    text = shown(True)
    lines = text[text.rindex("run ") :].splitlines()
    assert max(map(len, lines)) <= 80
    told = [line.split() for line in lines[2:] if line.strip()]
    # Seconds left come from the run's own speed.
    assert told[0] == ["two", "25%", "-12.5", "25", "%", "-", "12", "min", "30", "s"]
    assert told[1] == ["three", "100%", "-", "-", "100", "%", "-"]
    assert told[2] == ["one", "0%", "-", "-", "-", "waits"]


def test_what_all_names_begin_with_is_left_out():
    names = [f"Poke-v0-{mode}-seed{i}" for mode in ("shared", "single") for i in (0, 1)]
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    with ManyDisplay(dict.fromkeys(names, 64), console) as display:
        display.show(names[0], {"steps": 32})
    text = console.file.getvalue()
    assert all(name.removeprefix("Poke-v0-") in text for name in names)
    assert "Poke" not in text
    assert all(head in text for head in ("steps", "return", "completion", "validated"))


def test_elsewhere_than_on_a_terminal_lines_come_now_and_then():
    first, last = shown(False).splitlines()
    assert first == "0 of 3 runs done, 1 begun, 0.25 M of 3.00 M steps"
    assert last == "1 of 3 runs done, 1 begun, 1.25 M of 3.00 M steps"
