"""A league: who plays whom, who leaves copies, what is kept of it."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.learning.casting import EXPLOITERS, MAIN, make_casting
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.curve import draw_ratings
from collaborative_gym.learning.folder import LAST
from collaborative_gym.learning.league import League
from collaborative_gym.learning.pool import Iteration
from collaborative_gym.learning.run import Run
from collaborative_gym.policies.network import NetworkPolicy

MAIN_EXPLOITER, LEAGUE_EXPLOITER = EXPLOITERS
STEPS = 16 * 8

IN_A_PROCESS = """
import sys
sys.path.insert(0, sys.argv[1])
import collaborative_gym as cg
from conftest import CarryConfig, Duel
from collaborative_gym.learning import league, monitor
from collaborative_gym.learning.config import Resources

monitor.draw_curve = league.draw_ratings = lambda *_: None
cg.train(
    Duel([cg.get_robot("panda")] * 2, CarryConfig()),
    opponent=["league", "idle"],
    output=sys.argv[2],
    hyperparameters=cg.Hyperparameters(**eval(sys.argv[3])),
    resources=Resources(num_threads=1),
    checkpoint_interval=1,
)
"""


@pytest.fixture
def numbers(tiny):
    """Return a function that gives hyperparameters of small leagues."""
    small = {
        "total_steps": 6 * STEPS,
        "num_envs": 16,
        "validation_interval": 3 * STEPS,
        "league_least_steps": 20,
        "league_most_steps": 60,
    }
    return lambda **changes: tiny(**{**small, **changes})


@pytest.fixture
def policy(train_tiny, duel, tmp_path):
    """Return some policy of the small task."""
    return train_tiny(tmp_path / "some", task=duel, mode="shared").policy()


@pytest.fixture
def league(duel, numbers, policy, tmp_path):
    """Return a league of whom one policy was given, and what all play."""
    given = numbers(league_win_rate=0.7, league_least_steps=50, league_most_steps=500)
    casting = make_casting(duel, ["league", "idle"], (), hyperparameters=given)
    made = League(
        casting,
        {"idle": "idle"},
        hyperparameters=given,
        folder=tmp_path,
        title="a league",
        seed=0,
    )
    return made, lambda name: policy


def play(league, latest, games, steps=STEPS):
    """Let a league study games: home, away, points of home; return who begins anew."""
    score = {1.0: (1.0, 0.0), 0.5: (1.0, 1.0), 0.0: (0.0, 1.0)}
    rows: list[dict] = [
        dict(zip(("side_1/score", "side_2/score"), score[own], strict=True))
        for _, _, own in games
    ]
    seated = [(home, away) for home, away, _ in games]
    return league.study(Iteration(rows, {}, seated), league._steps + steps, latest)


def odds(league, latest, member):
    by_seat = league.invitation(latest).odds[member]
    assert by_seat["side_1"] == by_seat["side_2"]
    assert sum(by_seat["side_1"].values()) == pytest.approx(1.0)
    return by_seat["side_1"]


def test_the_worlds_are_shared_as_the_shares_say(duel, numbers):
    casting = make_casting(duel, ["league"], (), hyperparameters=numbers())
    spread = casting.spread(400)
    alone = sum(cast == (MAIN, MAIN) for cast in spread)
    hosted = {m: sum(m in cast for cast in spread) for m in (MAIN, *EXPLOITERS)}
    assert alone == 0.35 * 200
    assert hosted == {MAIN: 200, MAIN_EXPLOITER: 100, LEAGUE_EXPLOITER: 100}


def test_a_league_begins_with_a_copy_of_main(league, tmp_path):
    made, latest = league
    assert odds(made, latest, MAIN) == {"idle": 0.5, "main-0": 0.5}
    assert odds(made, latest, MAIN_EXPLOITER) == {MAIN: 1.0}
    assert odds(made, latest, LEAGUE_EXPLOITER) == {"idle": 0.5, "main-0": 0.5}
    assert NetworkPolicy.load(tmp_path / "players" / "main-0.safetensors")


def test_who_is_hard_to_beat_is_played_more(league):
    made, latest = league
    made.invitation(latest)
    games = [(MAIN, "idle", 1.0)] * 30 + [(MAIN, "main-0", 0.0)] * 30
    play(made, latest, [*games, *[("idle", LEAGUE_EXPLOITER, 0.0)] * 30], steps=1)
    assert odds(made, latest, MAIN) == {"idle": 0.0, "main-0": 1.0}
    exploiters = odds(made, latest, LEAGUE_EXPLOITER)
    assert exploiters == {"idle": 0.0, "main-0": 1.0}
    # Of all that counts for nothing, everybody is as good as another.
    play(made, latest, [(MAIN, "main-0", 1.0)] * 2000, steps=1)
    assert odds(made, latest, MAIN)["main-0"] == pytest.approx(0.5, abs=0.5)


def test_an_exploiter_leaves_main_alone_where_it_is_hopeless(league):
    made, latest = league
    made.invitation(latest)
    play(made, latest, [(MAIN_EXPLOITER, MAIN, 0.0)] * 30, steps=1)
    assert odds(made, latest, MAIN_EXPLOITER) == {"main-0": 1.0}


def test_copies_are_left_by_who_beats_all_or_after_long(league, tmp_path):
    made, latest = league
    made.invitation(latest)
    wins = [(MAIN, other, 1.0) for other in ("idle", "main-0")] * 30
    # Half of the worlds are main's: 40 steps are too early, and then it is time.
    play(made, latest, [*wins, (MAIN_EXPLOITER, MAIN, 0.5)], steps=80)
    assert "main-1" not in made.policies
    restarted = play(made, latest, [], steps=40)
    assert {"main-1"} == set(made.policies) - {"idle", "main-0"}
    assert not restarted
    restarted = play(made, latest, [(MAIN_EXPLOITER, MAIN, 1.0)] * 60, steps=100)
    assert "main_exploiter-1" in made.policies
    assert restarted == [(MAIN_EXPLOITER, MAIN)]
    # A copy has the results of whom it was copied from; who begins anew has main's.
    assert made._rates("main_exploiter-1", [MAIN]) > 0.9
    assert made._rates(MAIN_EXPLOITER, [MAIN, "idle"]).tolist() == [0.5, 1.0]
    assert made._rates(MAIN, ["idle"]) == 1.0
    play(made, latest, [(MAIN, "main-1", 0.0)] * 60, steps=2000)
    assert {"main-2", "league_exploiter-1"} <= set(made.policies)
    made.publish()
    content = json.loads((tmp_path / "league.json").read_text())
    players = content["players"]
    assert players["main-1"]["parent"] == MAIN
    assert players["main-1"]["steps"] == 120
    assert players["idle"]["parent"] is None
    assert content["payoff"]["main"]["idle"]["rate"] == 1.0
    assert players["main-2"]["rating"] > players["idle"]["rating"]


def test_what_main_does_not_beat_is_verified(league):
    made, latest = league
    made.invitation(latest)
    wins = [(MAIN, other, 1.0) for other in ("idle", "main-0")] * 60
    play(made, latest, wins, steps=1)
    play(made, latest, [(MAIN_EXPLOITER, MAIN, 1.0)] * 60, steps=500)
    assert "main_exploiter-1" in made.policies
    play(made, latest, [(MAIN, "main_exploiter-1", 0.0)] * 60, steps=1)
    found = odds(made, latest, MAIN)
    assert found["main_exploiter-1"] > 0.75
    assert found["idle"] == 0.0


def test_a_league_comes_back_from_its_state_and_files(league, duel, numbers, tmp_path):
    made, latest = league
    made.invitation(latest)
    play(made, latest, [(MAIN, "idle", 1.0)] * 5, steps=2000)
    state = made.state_dict()
    again = League(
        made._casting,
        {"idle": "idle"},
        hyperparameters=made._numbers,
        folder=tmp_path,
        title="",
        seed=0,
    )
    again.load_state_dict(state)
    assert again.policies.keys() == made.policies.keys()
    assert odds(again, latest, MAIN) == odds(made, latest, MAIN)
    path = tmp_path / "players" / "main-1.safetensors"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(
        ValueError, match=r"main-1\.safetensors is not a policy, or is d"
    ):
        again.load_state_dict(state)
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"main-1\.safetensors is gone"):
        again.load_state_dict(state)


def test_a_league_runs_and_its_players_can_be_named(train_tiny, duel, numbers):
    result = train_tiny(task=duel, opponent="league", hyperparameters=numbers())
    assert result.settings.mode == "shared"
    files = {file.stem for file in (result.folder / "players").iterdir()}
    assert {MAIN, *EXPLOITERS, "main-0", "main-1", "league_exploiter-1"} <= files
    content = json.loads((result.folder / "league.json").read_text())
    assert files == content["players"].keys()
    assert (result.folder / "ratings.png").exists()
    for name in files:
        assert cg.load_policy(f"{result.folder}/{name}").agents == duel.agents
    main, first = (cg.load_policy(f"{result.folder}/{n}") for n in (MAIN, "main-0"))
    rows = {a: np.ones((1, n)) for a, n in main.layout.observation_sizes.items()}
    assert not np.array_equal(main(rows)["robot_1"], first(rows)["robot_1"])
    whole = cg.load_policy(result.folder)
    assert np.array_equal(main(rows)["robot_1"], whole(rows)["robot_1"])
    # The latest main policy is the one that counts.
    assert result.best["steps"] == 6 * STEPS
    with pytest.raises(KeyError, match="no player 'main-99'"):
        cg.load_policy(f"{result.folder}/main-99")
    for name in files:
        (result.folder / "players" / f"{name}.safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"no policy file .*main-0 exists"):
        cg.load_policy(f"{result.folder}/main-0")


def weights(run, member):
    """Return the networks of a member as they are now, by name."""
    return run.policy(member).weights


def test_who_begins_anew_goes_on_from_main(train_tiny, duel, numbers, monkeypatch):
    restarted, restart = [], Run.restart

    def spied(self, member, like):
        before = weights(self, member)
        restart(self, member, like)
        after, model = weights(self, member), weights(self, like)
        key = next(iter(after))
        same = [
            np.array_equal(after[key].layers[0][0], each[key].layers[0][0])
            for each in (before, model)
        ]
        restarted.append((member, like, *same))

    monkeypatch.setattr(Run, "restart", spied)
    train_tiny(task=duel, opponent="league", hyperparameters=numbers())
    assert (MAIN_EXPLOITER, MAIN, False, True) in restarted


def test_who_begins_anew_may_begin_as_the_run_began(
    train_tiny, duel, numbers, monkeypatch
):
    begun = []
    restart = Run.restart

    def spied(self, member, like):
        restart(self, member, like)
        own = weights(self, member)
        begun.append((member, like, next(iter(own.values())).layers[0][0]))

    monkeypatch.setattr(Run, "restart", spied)
    train_tiny(task=duel, opponent="league", hyperparameters=numbers(league_fresh=1.0))
    exploiters = [
        w for member, like, w in begun if (member, like) == (MAIN_EXPLOITER, None)
    ]
    assert len(exploiters) > 1
    # Learned in between, and forgotten.
    assert all(np.array_equal(exploiters[0], weights) for weights in exploiters)


def test_ratings_are_drawn(tmp_path):
    path = tmp_path / "ratings.png"
    draw_ratings({MAIN: [(100, 1600.0), (0, 1400.0)], EXPLOITERS[0]: []}, "", path)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_a_killed_league_goes_on_as_if_nothing_had_been(
    train_tiny, duel, numbers, tmp_path
):
    given = numbers(total_steps=12 * STEPS, validation_interval=0)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    tests = str(Path(__file__).parents[1])
    arguments = [tests, str(cut), repr(vars(given))]
    process = subprocess.Popen([sys.executable, "-c", IN_A_PROCESS, *arguments])
    try:
        deadline = time.monotonic() + 120.0
        while (
            time.monotonic() < deadline
            and not (cut / "players" / "main-3.safetensors").exists()
        ):
            assert process.poll() is None
            time.sleep(0.002)
    finally:
        process.kill()
    assert process.wait() == -signal.SIGKILL
    assert 0 < Checkpoint.load(cut / LAST).backend["steps"] < given.total_steps
    train_tiny(resume=cut, task=duel, hyperparameters=given)
    train_tiny(whole, task=duel, opponent=["league", "idle"], hyperparameters=given)
    for file in sorted(whole.glob("players/*")):
        assert file.read_bytes() == (cut / "players" / file.name).read_bytes(), file
    assert len(list(cut.glob("players/*"))) == len(list(whole.glob("players/*")))
    for name in ("league.json", "policy.safetensors"):
        assert (cut / name).read_bytes() == (whole / name).read_bytes()
    assert not list(cut.rglob(".*"))


@pytest.mark.parametrize(
    ("opponent", "message"),
    [
        (["league", "self"], "self stands alone"),
        (["league", "side_1=idle"], "name a seat for each, or for none"),
        (["league", "idel"], "opponent 'idel': no policy 'idel'"),
    ],
)
def test_what_is_no_league_is_refused(train_tiny, duel, numbers, opponent, message):
    with pytest.raises((KeyError, ValueError), match=message):
        train_tiny(task=duel, opponent=opponent, hyperparameters=numbers())
