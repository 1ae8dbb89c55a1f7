"""Bad inputs to the command line: status 2, a sentence, and no traceback."""

import os
import subprocess
import sys

import pytest
from judging import command_fault
from test_scenes import BROKEN

from collaborative_gym.learning.config import Hyperparameters

EVALUATE = "evaluate Poke --policy random --episodes 1 --num-threads 1"
TRAIN = "train Poke --output {folder}/run --total-steps 32 --num-envs 2"
CERTIFY = "certify Poke --output {folder}"
REPORT = "report Poke --policies idle --episodes 1 --num-threads 1"
TOURNAMENT = "tournament Poke --policies idle expert --episodes 1 --num-threads 1"
RECORD = "record Poke --policy random --output {folder}/film.gif --size 32 32"

NO_INTEGERS = ("two", "1.5", "nan", "-1")
NO_NUMBERS = ("two", "nan", "inf", "-1", "1e300")

OPTIONS = [
    (EVALUATE, "--episodes", (*NO_INTEGERS, "0", "99999999999999999999")),
    (EVALUATE, "--seed", NO_INTEGERS),
    (EVALUATE, "--num-envs", (*NO_INTEGERS, "0", "99999999999999999999")),
    (EVALUATE, "--num-threads", (*NO_INTEGERS, "1000000")),
    (EVALUATE, "--randomization", ("papr", "", "0.1")),
    (EVALUATE, "--num-robots", ("0", "9", "x")),
    (EVALUATE, "--robots", ("x", "x y", "panda x")),
    (
        EVALUATE,
        "--policy",
        ("nobody", "nowhere.safetensors", "", "{folder}", "a/b"),
    ),
    (EVALUATE, "--idle", ("robot_9", "")),
    (EVALUATE, "--module", ("nowhere.py", "no.such", "", "a/b")),
    (EVALUATE, "--colour", ("red",)),
    (RECORD, "--seconds", (*NO_NUMBERS, "0")),
    (RECORD, "--seed", NO_INTEGERS),
    (RECORD, "--only-episodes", NO_INTEGERS),
    (RECORD, "--size", ("1", "a b", "-2 2", "3 2", "100000 2", "2 2 2")),
    (RECORD, "--beside", ("nobody",)),
    (RECORD, "--robots", ("x", "panda x")),
    (RECORD, "--randomization", ("papr",)),
    (RECORD, "--output", ("film", "film.avi", "", ".")),
    (TRAIN, "--mode", ("sharde", "")),
    (TRAIN, "--seed", NO_INTEGERS),
    (TRAIN, "--backend", ("sb3", "")),
    (TRAIN, "--algorithm", ("td3", "")),
    (TRAIN, "--device", ("tpu", "")),
    (TRAIN, "--num-threads", NO_INTEGERS),
    (TRAIN, "--torch-threads", (*NO_INTEGERS, "1000000")),
    (TRAIN, "--checkpoint-interval", (*NO_INTEGERS, "0")),
    (TRAIN, "--randomization", ("papr",)),
    (TRAIN, "--num-robots", ("0", "9", "x")),
    (TRAIN, "--robots", ("x",)),
    (TRAIN, "--hidden-sizes", ("0", "-1", "a", "1.5")),
    (TRAIN, "--activation", ("gelu", "")),
    (TRAIN, "--seeds", (*NO_INTEGERS, "3-1", "0-x", "0 0", "0-99999999")),
    (TRAIN, "--modes", ("sharde", "", "shared shared")),
    (TRAIN, "--jobs", NO_INTEGERS),
    (TRAIN, "--resume", ("nowhere",)),
    (CERTIFY, "--episodes", (*NO_INTEGERS, "0", "99999999999999999999")),
    (CERTIFY, "--fractions", ("a", "0", "1", "nan", "0.5 2")),
    (CERTIFY, "--candidates", (*NO_INTEGERS, "0")),
    (CERTIFY, "--rounds", (*NO_INTEGERS, "0")),
    (CERTIFY, "--ppo-steps", NO_INTEGERS),
    (CERTIFY, "--seed", (*NO_INTEGERS, "9999999999999999")),
    (CERTIFY, "--num-threads", (*NO_INTEGERS, "1000000")),
    (CERTIFY, "--randomization", ("papr", "")),
    (CERTIFY, "--robots", ("x", "panda x")),
    (REPORT, "--episodes", (*NO_INTEGERS, "0")),
    (REPORT, "--disturbed", (*NO_INTEGERS, "-1")),
    (REPORT, "--paired", (*NO_INTEGERS, "-1")),
    (REPORT, "--seed", NO_INTEGERS),
    (REPORT, "--num-envs", (*NO_INTEGERS, "0")),
    (REPORT, "--randomization", ("papr", "")),
    (REPORT, "--robots", ("x", "panda x")),
    (TOURNAMENT, "--episodes", (*NO_INTEGERS, "0", "99999999999999999999")),
    (TOURNAMENT, "--seed", NO_INTEGERS),
    (TOURNAMENT, "--seats", ("robot_9", "", "robot_1 robot_1", "all robot_1")),
    (TOURNAMENT, "--num-envs", (*NO_INTEGERS, "0")),
    (TOURNAMENT, "--num-threads", (*NO_INTEGERS, "1000000")),
    (TOURNAMENT, "--randomization", ("papr", "")),
    (TOURNAMENT, "--robots", ("x", "panda x")),
    (
        TOURNAMENT,
        "--policies",
        (
            "idle",
            "idle idle",
            "idle nobody",
            "idle a/b",
            "robot_1=idle idle",
        ),
    ),
    ("benchmark Poke", "--num-envs", (*NO_INTEGERS, "0")),
    ("benchmark Poke", "--num-threads", NO_INTEGERS),
    ("reproduce table11 --output {folder}", "--episodes", (*NO_INTEGERS, "0")),
    ("reproduce table11 --output {folder}", "--seed", NO_INTEGERS),
    ("reproduce table11 --output {folder}", "--num-threads", NO_INTEGERS),
    ("demo --output {folder}", "--episodes", (*NO_INTEGERS, "0")),
    ("view Poke --web", "--port", ("two", "-1", "70000")),
    ("view Poke --web", "--host", ("192.0.2.7", "no.host")),
    ("view Poke --web", "--policy", ("nobody", "a/b")),
    ("view Poke --web", "--seed", NO_INTEGERS),
]

HYPERPARAMETERS = [
    (
        TRAIN,
        f"--{name.replace('_', '-')}",
        NO_INTEGERS if isinstance(value, int) else NO_NUMBERS,
    )
    for name, value in vars(Hyperparameters()).items()
    if isinstance(value, int | float)
]

WHOLE = [
    ("frobnicate", "frobnicate"),
    ("evalute Poke", "did you mean 'evaluate'"),
    ("evaluate", "environment"),
    ("evaluate Lif --episodes 1", "Lif"),
    ("evaluate --all Poke", "not both"),
    ("record Poke", "--output"),
    ("record Lif --output {folder}/a.gif", "Lif"),
    ("record Poke Lift --output {folder}/a.gif", "Lift"),
    ("view", "ENV"),
    ("view Lif", "Lif"),
    ("train", "environment"),
    ("train Poke Lif", "Lif"),
    ("train Poke --seeds 0 1 --resume {folder}", "--resume"),
    ("compare", "folders of training runs"),
    ("compare {folder}", "{folder}"),
    ("train Lif", "Lif"),
    ("train Poke --total-steps 1e-6", "'1e-6' is not a whole number"),
    ("train Poke --seed None", "None is no value"),
    ("train Poke --learning-rate x", "'x' is not a number; write it as 0.001"),
    ("train Poke --hidden-sizes 64,64", "--hidden-sizes takes numbers, with spaces b"),
    ("train Poke --mode foo", "no mode 'foo'; modes: centralized, colla"),
    ("train Poke --algorithm None", "None is no value"),
    ("train --all --mode shared", "mode"),
    ("train --all --seed 1", "seed"),
    ("train Poke --output {folder}/a --resume {folder}/b", "{folder}/b"),
    ("benchmark Lif", "Lif"),
    ("certify", "environment"),
    ("certify Lif", "Lif"),
    ("certify --all Poke", "not both"),
    ("certify Poke --quick --episodes 3", "--quick"),
    (EVALUATE + " --policy expert:lat", "no expert style 'lat'"),
    ("tournament Lift --policies idle expert:ring-moves", "first-leads, late, second"),
    (f"{TOURNAMENT} --groups one=idle one=nobody", "nobody"),
    (f"{TOURNAMENT} --groups one=idle", "one"),
    (f"{TOURNAMENT} --groups idle", "gentle=runs/one"),
    ("tournament", "ENV"),
    ("tournament Poke", "--policies"),
    ("tournament Lif --policies idle expert", "Lif"),
    ("tournament Lift --policies idle PokeTaskSawyers-v0", "PokeTaskSawyers-v0"),
    (
        "tournament LiftTaskJacos-v0 --policies idle LiftTaskSawyers-v0",
        "player 'LiftTaskSawyers-v0': this policy is for",
    ),
    ("reproduce", "TABLE"),
    ("reproduce table12", "table12"),
    ("list Pooke", "Poke"),
    ("demo Poke", "Poke"),
    (EVALUATE + " --json {folder}/same --csv {folder}/same", "same"),
    (EVALUATE + " --json - --csv -", "two outputs"),
    ("evaluate Poke --robots panda jaco --policy PokeTaskSawyers-v0", "--any-env"),
]

CANNOT = [
    (EVALUATE + " --json {folder}", "{folder}"),
    (EVALUATE + " --csv /dev/null/a.csv", "/dev/null/a.csv"),
    (RECORD + " --output /proc/film.gif", "/proc/film.gif"),
    ("benchmark Poke --json {folder}", "{folder}"),
    ("train Poke --output /dev/null", "not a folder"),
    ("reproduce table11 --output /dev/null", "/dev/null"),
    ("certify Poke --quick --output /dev/null", "/dev/null"),
    ("demo --output /dev/null", "/dev/null"),
    (TOURNAMENT + " --output /dev/null", "/dev/null"),
    (TOURNAMENT + " --json /proc/a.json", "/proc/a.json"),
    (REPORT + " --output /dev/null", "/dev/null"),
]

INPUTS = [
    (
        f"{command} {option} {value}".split(" "),
        2,
        (option.lstrip("-"), repr(value), *value.split()),
    )
    for command, option, values in (*OPTIONS, *HYPERPARAMETERS)
    for value in values
]
INPUTS += [(line.split(" "), 2, (mentions,)) for line, mentions in WHOLE]
INPUTS += [(line.split(" "), 2, (mentions,)) for line, mentions in CANNOT]


@pytest.mark.parametrize(
    ("arguments", "status", "mentions"), INPUTS, ids=lambda given: str(given)[:150]
)
def test_a_command_tells_what_is_wrong(arguments, status, mentions, tmp_path):
    given, hints = (
        [part.replace("{folder}", str(tmp_path)) for part in parts]
        for parts in (arguments, mentions)
    )
    assert not command_fault(given, status, tuple(hints))


@pytest.mark.parametrize("name", BROKEN)
def test_a_command_tells_where_a_users_file_is_wrong(name, tmp_path):
    path = tmp_path / f"commanded_{name}.py"
    text = BROKEN[name]
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    status = 1 if name == "missing" else 2
    arguments = [*EVALUATE.split(), "--module", str(path)]
    assert not command_fault(arguments, status, (path.name,))


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("evaluate Lif", 2),
        ("evaluate Poke --episodes two", 2),
        ("frobnicate", 2),
        (EVALUATE + " --json /proc/a.json", 2),
    ],
)
def test_a_process_ends_with_the_status(line, status):
    command = [sys.executable, "-m", "collaborative_gym", *line.split()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == status
    assert "Traceback" not in done.stderr and len(done.stderr.split()) > 3


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_is_told_where_no_file_has_a_name(unbuffered):
    command = [sys.executable, "-m", "collaborative_gym", "list"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            command,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=300,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        )
    assert done.returncode == 1
    assert done.stderr == (
        "error: the system says 'No space left on device' of a file without a name,"
        " such as the output\n"
    )
