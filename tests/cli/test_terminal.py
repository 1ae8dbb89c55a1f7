"""What people see on a real terminal of 80 columns; files are as wide as needed."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios

import pytest

PROGRAM = [sys.executable, "-m", "collaborative_gym"]

PRINT = """
from collaborative_gym.cli import terminal
from collaborative_gym.cli.tables import Page
interval = "-1234.5 to -1000.5"
wide = ["PokeTaskPandaSawyer-v0\\nwith panda, sawyer", *["346.2\\n343.1 to 349.3"] * 5]
heads = ["environment", "reward", "completion", "performance", "at goal", "time"]
terminal.show(terminal.new_table(heads, [wide], caption="Means over 9 episodes."))
terminal.show(terminal.new_table(["name", *heads, *heads], [["x", *[interval] * 12]]))
marks, row = "|".join(["-"] * 12), "|".join([interval] * 12)
terminal.show(Page(f"|{'|'.join(heads * 2)}|\\n|{marks}|\\n|{row}|\\n"))
"""


def on_terminal(*command, columns=80):
    """Return what a command prints on a terminal, without colours."""
    main, its_end = pty.openpty()
    fcntl.ioctl(its_end, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    kept = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
    env = kept | {"TERM": "xterm"}
    ends = {"stdout": its_end, "stderr": subprocess.DEVNULL, "env": env}
    with subprocess.Popen(command, **ends):
        os.close(its_end)
        printed = b""
        try:
            while part := os.read(main, 65536):
                printed += part
        except OSError:  # how Linux tells that the other end is closed
            pass
    os.close(main)
    return re.sub(r"\x1b\[[\d;]*m|\r", "", printed.decode())


@pytest.mark.parametrize("columns", [50, 80])
def test_a_terminal_cuts_off_no_number(columns):
    printed = on_terminal(sys.executable, "-c", PRINT, columns=columns)
    assert max(map(len, printed.splitlines())) <= columns
    assert "…" not in printed
    words = printed.split()
    counts = [words.count(word) for word in ("343.1", "349.3", "-1234.5", "-1000.5")]
    assert counts == [5, 5, 24, 24]


def test_results_with_long_names_fit_a_terminal():
    options = ["--policy", "baseline", "--episodes", "4", "--num-threads", "1"]
    printed = on_terminal(*PROGRAM, "evaluate", "PokeTaskPandaSawyer-v0", *options)
    assert max(map(len, printed.splitlines())) <= 80
    for words in ("completion", "performance", "time to", "success", "clearance: "):
        assert words in printed


def test_a_narrow_terminal_keeps_ids_whole():
    printed = on_terminal(*PROGRAM, "list", "Pass", columns=60)
    starts = {line.split()[0] for line in printed.splitlines() if line.split()}
    assert {"PassTaskJacoSawyer-v0", "PassFrictionSawyers-v0"} <= starts
