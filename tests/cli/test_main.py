import json
import os
import re
import runpy
import signal
import subprocess
import sys
import time
from dataclasses import fields
from functools import partial
from importlib.metadata import version
from multiprocessing import dummy
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

import collaborative_gym as cg
from collaborative_gym import viewer
from collaborative_gym.cli import demo, environments, terminal
from collaborative_gym.cli.commands import Check, Evaluate, Record, Reproduce, View
from collaborative_gym.cli.main import main
from collaborative_gym.cli.terminal import new_table, progress_bars, read_policies
from collaborative_gym.cli.train import Train
from collaborative_gym.evaluation import table11
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.pictures import recording
from collaborative_gym.policies.policy import SHIPPED
from collaborative_gym.tasks.identity import Identity

PACKAGE = "collaborative-gym"


def test_list_has_a_line_per_environment(carry_id, capsys):
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for env_id in cg.list_envs():
        assert sum(line.split()[:1] == [env_id] for line in lines) == 1
    carry = next(line for line in lines if line.startswith(carry_id))
    assert carry.split()[1:] == ["Carry", "2", "panda", "-"]
    assert max(map(len, lines[: len(cg.list_envs()) + 2])) <= 80


def test_check_lists_the_broken_promises_of_a_task(carry_id, capsys):
    check = ["check", carry_id, "--episodes", "2"]
    assert main(check) == 0
    assert capsys.readouterr().out == f"{carry_id} keeps every promise\n"
    with pytest.raises(SystemExit, match="1"):
        main([*check, "--settings", "height=5.0"])
    told = " ".join(capsys.readouterr().out.split())
    assert "the expert does not reach the goal in the episodes [0, 1]" in told
    record = f"record {carry_id} --only-episodes 0 --output failed.mp4"
    assert f"`collaborative-gym {record}`, with your --module and options" in told


def test_check_shows_how_far_it_is(carry_id, capsys, monkeypatch):
    monkeypatch.setattr(terminal, "_LINE_INTERVAL", 0.0)
    assert main(["check", carry_id, "--episodes", "2"]) == 0
    assert f"checking {carry_id}: 56%\n" in capsys.readouterr().err


def test_a_renderer_that_mujoco_does_not_know_is_told_in_a_sentence():
    run = "import collaborative_gym_command as own; own.main()"
    done = subprocess.run(
        [sys.executable, "-c", run, "list"],
        capture_output=True,
        text=True,
        env={**os.environ, "MUJOCO_GL": "foo"},
    )
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert "MUJOCO_GL: foo; give egl, osmesa or glfw" in done.stderr


def test_check_says_what_it_could_not_test(carry, carry_id, capsys, monkeypatch):
    monkeypatch.setattr(type(carry()), "expert", cg.Task.expert)
    assert main(["check", carry_id, "--episodes", "2"]) == 0
    said, end = capsys.readouterr().out.splitlines()
    assert said.startswith("Carry has no expert(), so nothing has shown")
    assert end == f"{carry_id} keeps every promise that was tested"


def test_list_takes_a_part_of_a_name(capsys):
    assert main(["list", "poke"]) == 0
    printed = capsys.readouterr().out
    assert "PokeTaskSawyers-v0" in printed and "Lift" not in printed


@pytest.mark.parametrize(
    ("words", "env", "policy"),
    [
        ("evaluate --policy expert Carry --seed 1", ("Carry",), ("expert",)),
        ("evaluate --policy Poke Carry Lift", ("Carry", "Lift"), ("Poke",)),
        ("evaluate Carry --policy expert", ("Carry",), ("expert",)),
        ("record --policy idle Carry --output a.gif", "Carry", ("idle",)),
        ("record --output a.gif --only-episodes 1 2 Carry", "Carry", ("expert",)),
        ("train --seeds 0 1 Carry", ("Carry",), None),
    ],
)
def test_an_environment_may_follow_an_option_of_several_values(
    words, env, policy, monkeypatch
):
    asked = []
    for kind in (Evaluate, Record, Train):
        monkeypatch.setattr(kind, "run", lambda self: asked.append(self))
    assert main(words.split()) == 0
    (command,) = map(vars, asked)
    assert command.get("envs") == env or command.get("env") == env
    assert command.get("policy") == policy


def test_steps_may_be_written_with_an_exponent(monkeypatch):
    asked = []
    monkeypatch.setattr(Train, "run", lambda self: asked.append(self))
    assert main(["train", "Poke", "--total-steps", "1.5e6"]) == 0
    assert asked[0].hyperparameters.total_steps == 1_500_000
    monkeypatch.setattr(Check, "run", lambda self: asked.append(self))
    for words in (["--settings", "max_episode_steps=1e2"], ["--episodes=1e2"]):
        assert main(["check", "Poke", *words]) == 0
    assert asked[1].settings == ("max_episode_steps=100",)
    assert asked[2].episodes == 100


def test_a_benchmark_warns_of_more_threads_than_cpus(capsys, monkeypatch):
    monkeypatch.setattr("collaborative_gym.evaluation.speed.benchmark", None)
    assert main(["benchmark", "Poke", "--num-threads", "999"]) != 0
    assert "999 threads share" in capsys.readouterr().err


def test_list_builds_worlds_for_their_sizes_alone(carry_id, capsys, monkeypatch):
    monkeypatch.setattr(environments, "list_envs", lambda: [carry_id])
    with monkeypatch.context() as patched:
        patched.setattr(environments, "VectorEnv", None)
        assert main(["list"]) == 0
    assert main(["list", "--sizes"]) == 0
    lines = capsys.readouterr().out.splitlines()
    carry = [line.split() for line in lines if line.startswith(carry_id)]
    assert carry[1] == [carry_id, "2", "panda", "19,", "19", "8,", "8"]


def test_a_list_with_sizes_has_room_for_every_name(capsys, monkeypatch):
    monkeypatch.setattr(environments, "list_envs", lambda: ["HockeyDoubles-v0"])
    assert main(["list", "--sizes"]) == 0
    table = capsys.readouterr().out.partition("\n\n")[0]
    assert "HockeyDoubles-v0" in table and "31, 31, 31, 31" in table
    assert "…" not in table


@pytest.mark.parametrize("is_terminal", [True, False])
def test_no_table_hides_a_number(capsys, monkeypatch, is_terminal):
    row = ["PokeTaskSawyers-v0\nwith panda, sawyer", *["-1234.5 to -1000.5"] * 6]
    table = new_table(["environment", *["mean reward"] * 6], [row])
    wide = {"force_terminal": is_terminal, "width": 80, "color_system": None}
    monkeypatch.setattr(terminal, "_Output", partial(Console, **wide))
    terminal.show(table)
    lines = capsys.readouterr().out.splitlines()
    words = " ".join(lines).split()
    assert words.count("-1234.5") == words.count("-1000.5") == 6
    assert "PokeTaskSawyers-v0" in words
    assert (max(map(len, lines)) <= 80) == is_terminal


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("certify Poke --output {folder}", True),
        ("tournament Poke --policies idle expert --output {folder}", True),
        ("tournament Poke --policies idle expert", False),
    ],
)
def test_ctrl_c_tells_what_the_same_command_continues(
    command, told, capsys, monkeypatch, tmp_path
):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    for work in ("certificate.certify.certify", "tournaments.play.tournament"):
        monkeypatch.setattr(f"collaborative_gym.{work}", interrupt)
    assert main(command.format(folder=tmp_path).split()) == 130
    said = "stopped; the same command continues" in capsys.readouterr().err
    assert said == told


def test_a_file_named_dash_is_standard_output(carry_id, capsys):
    arguments = "evaluate Carry --episodes 2 --num-envs 2 --num-threads 1 --json -"
    assert main(arguments.split()) == 0
    printed = capsys.readouterr()
    json.loads(printed.out)
    assert "Carry" in printed.err


def test_lines_tell_the_progress_where_there_is_no_terminal(capsys, monkeypatch):
    with progress_bars() as progress:
        progress("quick")(0.5)
        monkeypatch.setattr(terminal, "_LINE_INTERVAL", 0.0)
        slow = progress("slow")
        slow(0.25)
        monkeypatch.setattr(terminal, "_LINE_INTERVAL", 10.0)
        slow(0.5)
        slow(1.0)
    assert capsys.readouterr() == ("", "slow: 25%\nslow: 100%\n")


def test_evaluate_prints_a_table_and_writes_files(carry_id, capsys, tmp_path):
    files = tmp_path / "a.json", tmp_path / "a.csv"
    arguments = ["evaluate", carry_id, "--episodes", "3", "--num-threads", "1"]
    assert main([*arguments, "--json", str(files[0]), "--csv", str(files[1])]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].rstrip() == "expert on default"
    assert "100 %" in "".join(lines)
    assert "3 episodes and their 95 % intervals" in " ".join(" ".join(lines).split())
    content = json.loads(files[0].read_text())
    assert content[carry_id]["completion"]["mean"] == 1.0
    assert len(files[1].read_text().splitlines()) == 4


def test_settings_of_the_task_are_options(carry_id, capsys):
    arguments = ["evaluate", carry_id, "--episodes", "1", "--policy", "idle"]
    settings = "max_episode_steps=7", "wrench=raw", "pad_force=true"
    assert main([*arguments, "--settings", *settings, "--json", "-"]) == 0
    printed = capsys.readouterr()
    (report,) = json.loads(printed.out).values()
    config = report["settings"]["identity"]["config"]
    assert (config["max_episode_steps"], config["wrench"]) == (7, "raw")
    assert config["pad_force"] is True
    assert "idle on default, max_episode_steps=7, wrench=raw" in printed.err
    assert "Means over 1 episode;" in printed.err


def test_settings_with_an_option_of_their_own_are_refused(carry_id, capsys):
    for name, flag in (("robots", "--robots"), ("num_robots", "--num-robots")):
        assert main(["evaluate", carry_id, "--settings", f"{name}=panda"]) == 2
        error = f"error: give {name} by {flag}, not by --settings\n"
        assert capsys.readouterr().err == error


def test_thesis_and_we_count_200_episodes(carry_id):
    commands = Evaluate(), Reproduce(table="table11")
    assert [command.episodes for command in commands] == [200, 200]
    report = cg.evaluate(carry_id, "random", num_threads=1)
    assert len(report.episodes) == 200


def test_evaluate_takes_robots_presets_and_a_policy_for_each(carry_id, tmp_path):
    file = tmp_path / "a.json"
    options = "--episodes 1 --seed 5 --randomization paper --action tcp"
    robots = "--robots panda jaco --policy robot_1=random robot_2=idle"
    arguments = ["evaluate", "Carry", *options.split(), *robots.split()]
    assert main([*arguments, "--json", str(file)]) == 0
    settings = json.loads(file.read_text())["Carry"]["settings"]
    identity = Identity.from_dict(settings["identity"])
    assert identity.robot_names == ("panda", "jaco")
    assert identity.config["randomization"]["joint_noise"] == 0.0
    assert identity.action == "tcp"
    assert (settings["seed"], settings["policy"]) == (5, "robot_1=random robot_2=idle")


def test_all_leaves_out_what_has_no_baseline(capsys, monkeypatch):
    ids = ["TugSawyers-v0", "PokeTaskSawyers-v0"]
    monkeypatch.setattr(cg, "list_envs", lambda: ids)
    assert main(["evaluate", "--all", "--policy", "baseline", "--episodes", "1"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("left out because they have no baseline: TugSawyers-v0")
    assert "PokeTaskSawyers-v0" in told and told.count("TugSawyers") == 1


def test_all_commands_play_the_same_policy_unless_told_otherwise():
    played = Record(env="Poke", output=Path("a.gif")), Evaluate(), View(env="Poke")
    assert {command.policy for command in played} == {("expert",)}


def test_words_for_robots_that_follow_each_other_are_one_policy():
    words = "expert", "robot_1=a", "robot_2=b", "robot_1=c/d=e", "robot_2=f", "./g=h"
    assert read_policies(words) == [
        "expert",
        {"robot_1": "a", "robot_2": "b"},
        {"robot_1": "c/d=e", "robot_2": "f"},
        "./g=h",
    ]


def test_reproduce_prints_the_table_and_writes_files(
    carry_id, capsys, tmp_path, monkeypatch
):
    monkeypatch.setattr(table11, "THESIS", {carry_id: table11.Thesis(-1.0, 0.5, 0.5)})
    monkeypatch.setitem(SHIPPED, "baseline", tmp_path)
    folder = tmp_path / "a" / "b"
    arguments = "reproduce table11 --episodes 3 --seed 2 --num-threads 1 --output"
    assert main([*arguments.split(), str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "FAIL: 5 of 5 cells"
    assert max(map(len, lines[:-2])) <= 80
    completion = next(line for line in lines if "completion" in line)
    assert completion.split()[:5] == ["completion", "50.00", "%", "-", "FAIL"]
    content = json.loads((folder / "table11.json").read_text())
    assert (content["episodes"], content["seed"]) == (3, 2)
    assert carry_id in (folder / "table11.md").read_text()
    assert len(list(folder.iterdir())) == 2


def test_certify_prints_a_table_writes_files_and_goes_on(carry_id, capsys, tmp_path):
    arguments = ["certify", carry_id, "--quick", "--num-threads", "1", "--output"]
    assert main([*arguments, str(tmp_path)]) == 0
    begun, *lines = capsys.readouterr().out.splitlines()
    assert begun.startswith(f"{carry_id}: each arm in turn is still")
    told = [line for line in lines if line.startswith(f"{carry_id}, ")]
    assert len(told) == 32 and "robot_1 idle, expert: " in told[0]
    assert lines[-1] == f"wrote {tmp_path / 'certificates.md'}"
    content = json.loads((tmp_path / carry_id / "certificate.json").read_text())
    assert len(content["trials"]) == 32
    assert carry_id in (tmp_path / "certificates.md").read_text()
    assert main([*arguments, str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == [begun, *lines[len(told) :]]


def test_tournament_prints_tables_writes_files_and_goes_on(carry_id, capsys, tmp_path):
    words = f"tournament {carry_id} --policies idle expert --episodes 2"
    line = [*f"{words} --groups scripted=idle scripted=expert".split()]
    line += ["--num-threads", "1", "--output", str(tmp_path / "out")]
    assert main(line) == 0
    told = capsys.readouterr().out
    assert "idle + expert" in told and "robot_1 / robot_2" in told
    assert "worst: idle" in told and "self-play" in told and "2 of scripted" in told
    assert "Groups of partners with which one robot_2 plays well:" in told
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"pairings", "tournament.json", "tournament.csv"}
    assert main([*line, "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((tmp_path / "out" / "tournament.json").read_text())
    assert told["players"] == ["idle", "expert"]


def test_report_prints_cards_and_writes_pages(carry_id, capsys, tmp_path):
    line = [*f"report {carry_id} --episodes 2 --disturbed 1 --paired 1".split()]
    line += ["--num-threads", "1", "--policies", "expert", "idle"]
    assert main([*line, "--output", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "Robustness" in told and "Cross-play" in told
    page = (tmp_path / "out" / f"{carry_id}.md").read_text()
    for name in page.split("](")[1:]:
        assert (tmp_path / "out" / name.partition(")")[0]).exists()
    assert main([*line, "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)[carry_id]
    assert told == json.loads((tmp_path / "out" / f"{carry_id}.json").read_text())


def test_record_writes_the_video(carry_id, capsys, tmp_path):
    file = tmp_path / "a.gif"
    size = ["--size", "64", "48", "--seconds", "1"]
    assert main(["record", carry_id, "--output", str(file), *size]) == 0
    assert file.stat().st_size > 0
    assert str(file) in capsys.readouterr().out


def test_the_demo_draws_before_it_measures_and_tells_how_to_watch(
    carry_id, capsys, tmp_path, monkeypatch
):
    monkeypatch.setattr(table11, "THESIS", {carry_id: table11.Thesis(-1.0, 0.5, 0.5)})
    monkeypatch.setitem(SHIPPED, "baseline", tmp_path)
    # Threads know the environment of this test, and may not heed signals.
    threads = SimpleNamespace(get_context=lambda _: dummy)
    monkeypatch.setattr(demo, "multiprocessing", threads)
    monkeypatch.setattr(demo, "_begin_worker", lambda: None)
    monkeypatch.setattr(demo, "_GAME", "TugPandas-v0")
    monkeypatch.setattr(demo, "_SECONDS", 0.5)
    small = partial(recording.record, size=(64, 48))
    monkeypatch.setattr(recording, "record", small)
    monkeypatch.setattr(sys, "argv", [".venv/bin/collaborative-gym", "demo"])
    folder = tmp_path / "out"
    assert main(["demo", "--episodes", "2", "--output", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = ["contact_sheet.png", f"{carry_id}.mp4", "TugPandas-v0.mp4"]
    sheet, *films = [folder / name for name in names]
    assert lines[1].startswith(f"wrote {sheet}; 2 films follow")
    assert lines[2:4] == [f"film {i} of 2: {film}" for i, film in enumerate(films, 1)]
    assert {path.name for path in folder.iterdir()} >= {*names, "table11.md"}
    assert "2 episodes" in lines[4] and f"are in {folder}/." in lines[-4]
    assert lines[-3] == "  .venv/bin/collaborative-gym reproduce table11"
    assert lines[-1].startswith(f"  .venv/bin/collaborative-gym view {carry_id} --")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("evaluate CarryPanda-v0", "did you mean 'CarryPandas-v0'?"),
        ("evaluate Carry --all", "name environments or pass --all, not both"),
        ("evaluate Carry --json a --csv a", "a is named for two outputs"),
        ("evaluate", "environments to evaluate, or pass"),
        ("evaluate Carry --policy exprt", "did you mean 'expert'?"),
        ("evaluate Carry --policy expert idle", "robot_2=idle, got expert idle"),
        (
            "evaluate Carry --policy robot_1=idle",
            "there is no policy for the agent robot_2",
        ),
        ("evaluate Carry --policy robot_3=idle", "no agent 'robot_3'"),
        ("evaluate Carry --robots panda panda panda", "needs 2 robots, got 3"),
        ("evaluate Carry --robots panda jako", "did you mean 'jaco'?"),
        ("evaluate Carry --randomization none", "default, hard, lost, paper, wide"),
        ("evaluate Carry --episodes 0", "episodes must be at least 1"),
        ("evaluate Carry Lift Carry", "Carry is named twice; name each environment"),
        ("record Carry --output a.avi", ".gif or .mp4"),
        ("certify", "environments to certify, or pass --all"),
        ("certify Cary", "did you mean 'Carry'?"),
        ("certify Carry --episodes 0", "episodes must be at least 1"),
        ("certify Carry --quick --rounds 3", "--quick has a budget of its own"),
        ("reproduce table12", "did you mean 'table11'?); tables: table11"),
        ("benchmark Cary", "did you mean 'Carry'?"),
        ("evalute Carry", "no command 'evalute' (did you mean 'evaluate'?); commands"),
        (
            "evaluate Carry --settings wrench",
            "its value, such as wrench=raw, got",
        ),
        ("evaluate Carry --settings wrnch=raw", "'wrnch' (did you mean 'wrench'?); op"),
        ("evaluate Carry --settings wrench=rw", "no wrench mode 'rw' (did you mean 'r"),
        ("evaluate Carry --settings max_episode_steps=x", "max_episode_steps must be"),
        ("view Carry --port 99999", "port must be at most 65535, got 99999"),
        ("evaluate Carry --polcy idle", "not take --polcy (did you mean --policy?); e"),
        (
            "evaluate Carry --policies idle --epsodes 3",
            "evaluate does not take --policies (did you mean --policy?) and --epsodes"
            " (did you mean --episodes?); evaluate --help",
        ),
        ("train Carry --leage-reset 1", "(did you mean --league-reset?); train --help"),
        ("record --robots panda jaco Cary --output a.mp4", "did you mean 'Carry'?"),
        ("evaluate --policy Carry", "name the environments to evaluate"),
        ("evaluate Carry --robots panda,jaco", "--robots: separate names by spaces, g"),
        ("evaluate Carry --num-robots 3 --robots panda jaco", "of them in --robots\n"),
        ("evaluate Qqq", "no environment 'Qqq'; environments: "),
        ("list Qqq", "no environment 'Qqq'; environments: "),
        ("record Carry -o a.mp4", "not take -o; options begin with --"),
        (
            "evaluate Carry --seed 1 2",
            "evaluate does not take 2; evaluate --help lists",
        ),
    ],
)
def test_bad_input_is_one_line_and_status_2(carry_id, capsys, arguments, message):
    assert main(arguments.split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("error: ") and printed.err.count("\n") == 1
    assert message in printed.err


def test_a_wrong_id_among_others_shows_before_the_work(carry_id, monkeypatch, capsys):
    monkeypatch.setattr("collaborative_gym.evaluation.evaluate", None)
    assert main(["evaluate", carry_id, "Cary", "--policy", "expert"]) == 2
    assert "did you mean 'Carry'?" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["evaluate", "benchmark"])
def test_what_cannot_be_written_shows_before_the_work(tmp_path, capsys, command):
    files = tmp_path, tmp_path / "a" / "b.json"
    (tmp_path / "a").touch()
    for file in files:
        arguments = [command, "PokeTaskSawyers-v0", "--json", str(file)]
        started = time.perf_counter()
        assert main(arguments) == 2
        assert time.perf_counter() - started < 1.0
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.startswith(f"error: cannot write {file}: ")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]


def test_reproduce_shows_before_the_work_that_it_cannot_write(tmp_path, capsys):
    (tmp_path / "table11.json").mkdir()
    assert main(["reproduce", "table11", "--output", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"error: cannot write {tmp_path / 'table11.json'}: ")


def test_benchmark_takes_a_tasks_name(capsys):
    arguments = ["benchmark", "Poke", "--num-envs", "2", "--num-threads", "1"]
    assert main([*arguments, "--json", "-"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["environments"][0]["environment"] == "Poke"
    printed = " ".join(printed.err.split())
    assert "2 worlds on 1 thread" in printed


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        ("--policy expert evaluate Poke", "--policy comes after a command; see"),
        ("tournament Poke", "tournament needs --policies POLICY, two players or more,"),
        (
            "record Poke --output a.mp4 --seconds 3 --only-episodes 1",
            "give --seconds or --only-episodes, not both",
        ),
        ("evaluate Poke Lift --settings pot_mass=3", "Poke has no option 'pot_mass'"),
        (
            "record Poke --output a.mp4 --size 640",
            "--size takes a width and a height, such as 640 360",
        ),
        (
            "record Poke --output a.mp4 --size 9 big",
            "--size takes numbers, with spaces between",
        ),
        ("evaluate Poke --episodes ten", "--episodes: 'ten' is not a whole number; wr"),
        (
            "train Poke --mode colaborative",
            "no mode 'colaborative' (did you mean 'coll",
        ),
        ("record Poke", "record needs --output FILE, the video, .mp4 or .gif; missing"),
        (
            "view",
            "view needs ENV, an environment's id, or a task's name\n",
        ),
        ("-v", "collaborative-gym does not take -v; options begin with --"),
        ("report Poke --policy expert", "report has no --policy; give --policies"),
        ("--frobnicate", "collaborative-gym does not take --frobnicate; coll"),
    ],
)
def test_the_parsers_complaints_are_one_sentence(capsys, words, answer):
    assert main(words.split()) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"error: {answer}") and message.count("\n") == 1


@pytest.mark.parametrize("command", ["view", "compare", "certify", "benchmark"])
def test_help_fits_into_the_columns_of_a_file(capsys, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 80


def test_names_of_policies_come_before_ids(capsys):
    assert main(["evaluate", "Poke", "--policy", "bogus"]) == 2
    names = "; policies: baseline, ego, expert, random, idle, gripping, frozen, limp,"
    assert names in capsys.readouterr().err


@pytest.mark.parametrize("flag", ["--version", "-V"])
def test_version_is_that_of_the_package(capsys, flag):
    assert main([flag]) == 0
    assert capsys.readouterr().out == f"collaborative-gym {version(PACKAGE)}\n"


def test_without_a_command_it_helps(capsys):
    with pytest.raises(SystemExit, match="0"):
        main([])
    usage = "usage: collaborative-gym [-h] COMMAND ...\n"
    assert capsys.readouterr().out.startswith(usage)


def test_environments_are_optional_where_help_says_so(capsys):
    for command in ("evaluate", "certify", "benchmark", "train"):
        with pytest.raises(SystemExit, match="0"):
            main([command, "--help"])
        assert " [ENV ...]" in capsys.readouterr().out.splitlines()[0]


@pytest.mark.parametrize(
    "command",
    [
        "",
        "record",
        "evaluate",
        "tournament",
        "certify",
        "compare",
        "report",
        "reproduce",
        "view",
        "benchmark",
        "train",
    ],
)
def test_help_fits_a_terminal(capsys, command):
    with pytest.raises(SystemExit, match="0"):
        main([*command.split(), "--help"])
    assert "usage: collaborative-gym" in capsys.readouterr().out


def test_help_has_no_words_of_the_parser(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["train", "--help-all"])
    page = capsys.readouterr().out
    assert "--ray-address HOST:PORT" in page and "(default: none)" in page
    assert "(default: )" not in page and "{None}" not in page


def test_the_help_of_train_is_short_and_names_all_options(capsys):
    told = {}
    for asked in ("--help", "--help-all"):
        with pytest.raises(SystemExit, match="0"):
            main(["train", asked])
        told[asked] = capsys.readouterr().out
    assert told["--help"].count("\n") < 130
    assert "penalty on torque" in told["--help-all"]
    options = {f"--{each.name.replace('_', '-')}" for each in fields(Hyperparameters)}
    for text in told.values():
        assert options <= {*re.findall(r"--[a-z-]+", text)}


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window may open")
@pytest.mark.parametrize(
    "flag", [["--env", "Carry"], ["--env=Carry"], ["view", "Carry"]]
)
def test_view_without_display_and_extra_says_what_to_do(
    carry_id, capsys, monkeypatch, flag
):
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.delitem(sys.modules, "collaborative_gym.viewer.web", raising=False)
    monkeypatch.delitem(sys.modules, "collaborative_gym.viewer.shapes", raising=False)
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.setattr(sys, "argv", ["collaborative_gym", *flag])
    with pytest.raises(SystemExit) as ending:
        runpy.run_module("collaborative_gym", run_name="__main__")
    assert ending.value.code == 1
    printed = capsys.readouterr()
    assert "no display to open a window on" in printed.out
    assert printed.err.startswith("error: the viewer in the browser needs viser")
    assert "--constraint constraints.txt --editable '.[view]'" in printed.err
    assert "collaborative-gym record" in printed.err


def test_view_hands_on_what_is_asked_for(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(
        viewer, "view", lambda *given, **named: asked.append((given, named))
    )
    assert main(["view", "Lift"]) == 0
    options = "--seed 3 --robots panda jaco --action tcp --any-env"
    served = "--policy robot_1=expert robot_2=idle --web --host 0.0.0.0 --port 99"
    assert main(["view", "Lift", *options.split(), *served.split()]) == 0
    (task, tell), named = asked[0]
    warn = named.pop("warn")
    assert (task.name, task.config.action) == ("Lift", "joints")
    assert named == {
        "policy": "expert",
        "any_env": False,
        "seed": 0,
        "num_envs": 1,
        "address": None,
    }
    other = asked[1][0][0]
    arms = [robot.name for robot in other.robots.values()]
    assert (arms, other.config.action) == (["panda", "jaco"], "tcp")
    assert asked[1][1] == {
        "warn": warn,
        "policy": {"robot_1": "expert", "robot_2": "idle"},
        "any_env": True,
        "seed": 3,
        "num_envs": 1,
        "address": ("0.0.0.0", 99),
    }
    tell("here"), warn("beware")
    assert capsys.readouterr() == ("here\n", "beware\n")


@pytest.mark.parametrize(
    ("sent", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
)
def test_a_signal_ends_it_and_leaves_no_file(tmp_path, sent, status):
    module = [sys.executable, "-m", "collaborative_gym", "record"]
    output = ["--output", str(tmp_path / "a.mp4"), "--seconds", "99"]
    process = subprocess.Popen([*module, "PokeTaskSawyers-v0", *output])
    try:
        deadline = time.monotonic() + 60
        while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.05)
        time.sleep(0.5)
        os.kill(process.pid, sent)
        assert process.wait(timeout=30) == status
        assert list(tmp_path.iterdir()) == []
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("after", [0.1, 0.2, 0.3, 0.4])
def test_ctrl_c_ends_it_silently_while_it_loads(after):
    run = "import collaborative_gym_command as own; print(1, flush=True); own.main()"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", run, "list"], **pipes) as process:
        assert process.stdout.readline() == b"1\n"
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == b""
    assert process.returncode in (0, 130)  # It may have ended by then.


@pytest.mark.parametrize("command", [["train", "--help"], ["list"]], ids=str)
def test_it_ends_quietly_where_nobody_reads_on(command):
    module = [sys.executable, "-m", "collaborative_gym", *command]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(module, **pipes) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


def test_evaluate_says_what_it_has_in_place_of_an_output(carry_id, capsys):
    assert main(["evaluate", carry_id, "--output", "a.json"]) == 2
    assert "--json FILE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("train Poke --learning-rate -1", "--learning-rate must be 0 to 1, got -1.0"),
        ("evaluate Poke --episodes=0", "--episodes must be at least 1, got 0"),
        ("certify Poke --fractions 2", "each of --fractions must be 0.01 to 0.99"),
        ("train Poke --opponent league", "leave out --opponent, or give a partner"),
    ],
)
def test_an_error_names_options_as_they_were_typed(command, told, capsys):
    assert main(command.split()) == 2
    assert told in capsys.readouterr().err
