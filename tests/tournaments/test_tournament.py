"""Tournaments of small tasks: who plays with whom, and what is kept."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.tournaments import play as playing


def rising(observations):
    """Turn all joints one way."""
    return {a: np.full((len(rows), 8), 0.3) for a, rows in observations.items()}


@pytest.fixture
def run(carry):
    """Return a function that lets policies play the small task."""

    def run(policies, task=None, **options):
        options = {"episodes": 5, "num_threads": 1} | options
        return cg.tournament(task or carry(), policies, **options)

    return run


def test_every_policy_plays_in_every_seat_with_every_other(run, carry):
    names = []
    played = run(["expert", "idle"], on_pairing=lambda each: names.append(each.title))
    assert len(names) == len(set(names)) == 4
    assert played.players == ("expert", "idle")
    assert played.seats == {"robot_1": ("robot_1",), "robot_2": ("robot_2",)}
    for first in played.players:
        for second in played.players:
            pair = {"robot_1": first, "robot_2": second}
            report = cg.evaluate(carry(), pair, episodes=5, num_threads=1)
            entry = played.matrices["return"][first][second]
            assert entry == report.mean_reward
    own = played.standings["expert"].self_play
    assert own["completion"].mean == 1.0


@pytest.mark.parametrize("state", ["limp", "absent"])
def test_limp_and_absent_arms_play_as_evaluate_lets_them(run, carry, tmp_path, state):
    played = run(["expert", state], output=tmp_path)
    pair = {"robot_1": "expert", "robot_2": state}
    report = cg.evaluate(carry(), pair, episodes=5, num_threads=1)
    assert played.matrices["return"]["expert"][state] == report.mean_reward
    assert run(["expert", state], output=tmp_path).to_json() == played.to_json()


def test_numbers_do_not_depend_on_worlds_threads_and_order(run):
    policies = {"one": "expert", "two": "random", "three": "idle"}
    expected = run(policies, num_envs=5, num_threads=2)
    assert run(policies, num_envs=1).to_json() == expected.to_json()
    assert run(policies, num_envs=2).to_json() == expected.to_json()
    turned = run(dict(reversed(policies.items())))
    for name in "one", "two":
        entry = turned.matrices["return"][name]["three"]
        assert entry == expected.matrices["return"][name]["three"]


def test_sides_play_against_one_another(run, duel):
    played = run({"still": "idle", "random": "random", "up": rising}, duel, episodes=16)
    assert played.is_divided and played.seats["side_2"] == ("robot_2",)
    report = cg.evaluate(
        duel, {"robot_1": "random", "robot_2": "idle"}, episodes=16, num_threads=1
    )
    rows = report.episodes
    wins = np.mean(
        [np.sign(row["side_1/score"] - row["side_2/score"]) / 2 + 0.5 for row in rows]
    )
    assert played.matrices["points"]["random"]["still"].mean == wins
    assert played.matrices["points"]["still"]["still"].mean == 0.5
    standing = played.standings["random"]
    assert standing.wins + standing.draws + standing.losses == 4 * 16
    assert standing.rating.low <= standing.rating.mean <= standing.rating.high
    points = [each.cross_play["points"].mean for each in played.standings.values()]
    ratings = [rating.mean for rating in played.ratings.values()]
    np.testing.assert_array_equal(np.argsort(points), np.argsort(ratings))


def test_sides_of_several_robots_are_seats():
    sides = {"side_1": ("robot_1", "robot_3"), "side_2": ("robot_2",)}
    assert playing._seats(SimpleNamespace(sides=sides)) == sides


def test_with_more_seats_one_player_sits_among_others():
    players = [playing.Player(name, {}, name) for name in "ab"]
    seats = {f"robot_{i}": () for i in (1, 2, 3)}

    def lineups(turns):
        casts, _ = playing._casts(players, seats, turns)
        return ["".join(p.name for p in cast.values()) for cast in casts]

    every = ["aaa", "abb", "baa", "bbb", "bab", "aba", "bba", "aab"]
    assert lineups(tuple(seats)) == every
    assert lineups(("robot_2",)) == ["aaa", "bab", "aba", "bbb"]


def test_a_file_plays_where_it_has_parts(run, carry, network):
    half = network(carry(), "half.safetensors", ("robot_1",))
    both = network(carry(), "both.safetensors", one_network=True)
    played = run([half, both, "idle"])
    titles = {each.title for each in played.pairings}
    assert titles == {
        f"{half} + idle",
        f"{both} + {both}",
        "idle + idle",
    }
    assert "commands robot_1, not robot_2" in played.left_out[f"idle + {half}"]
    assert "one network" in played.left_out[f"{both} + idle"]


def test_runs_in_one_folder_are_of_one_kind(run, carry, network):
    paths = [network(carry(), f"runs/{i}/policy.safetensors", seed=i) for i in (1, 2)]
    played = run([*paths, "idle"], episodes=2)
    (kind,) = played.groups
    assert Path(kind) == paths[0].parents[1]
    assert played.groups[kind] == tuple(map(str, paths))
    assert "completion of cross-play" in played.group_means[kind]
    assert not run([*paths, "idle"], episodes=2, groups={}).group_means


@pytest.mark.parametrize(
    ("policies", "options", "message"),
    [
        (["expert"], {}, r"two policies or more, got 1 \(expert\)"),
        ([], {}, r"two policies or more, got 0 \(none\)"),
        ("expert", {}, "policies must be a list of policies"),
        (["expert", "idle", "expert"], {}, "2 policies are named 'expert'"),
        (["expert", "nobody"], {}, "player 'nobody': no policy 'nobody'"),
        (["expert", "no/file"], {}, "player 'no/file': no policy file"),
        (["expert", {"robot_1": "idle"}], {}, "no policy for the agent robot_2"),
        (["expert", {"robot_9": "idle"}], {}, "no agent 'robot_9'"),
        (["expert", 3], {}, "player 'int': policy must be one of"),
        (["expert", "idle"], {"episodes": 0}, "episodes must be at least 1"),
        (["expert", "idle"], {"seats": "robot_3"}, "no seat 'robot_3'"),
        (["expert", "idle"], {"seats": ()}, 'seats must be "all"'),
        (["expert", "idle"], {"groups": {"a": ["expert"]}}, "two players or more"),
        (["expert", "idle"], {"groups": {"a": ["expert", "x"]}}, "no player 'x'"),
    ],
)
def test_what_cannot_be_played_is_told_before(run, policies, options, message):
    with pytest.raises((LookupError, OSError, TypeError, ValueError), match=message):
        run(policies, on_pairing=lambda _: pytest.fail("played"), **options)


def test_a_policy_for_something_else_is_named(run, carry, network):
    other = network(carry(("jaco", "panda")), "other.safetensors")
    with pytest.raises(ValueError, match=r"player '.*other.safetensors': this pol"):
        run(["idle", other])
    alone = network(carry(), "alone.safetensors", ("robot_2",))
    both = network(carry(), "both.safetensors", one_network=True)
    with pytest.raises(ValueError, match=r"alone.safetensors' cannot play.*not rob"):
        run([both, alone])


def test_a_task_of_one_robot_has_no_tournament(carry):
    alone = ("robot_1",)
    env = SimpleNamespace(sides={"side_1": alone}, agents=alone, task=carry())
    with pytest.raises(ValueError, match="one robot, which has nobody to play with"):
        playing._seats(env)


class Stop(Exception):
    """What a callback raises to stop a tournament."""


def test_a_tournament_goes_on_where_it_stopped_and_takes_more_players(run, tmp_path):
    def stop_after(count):
        titles = []

        def heard(pairing):
            titles.append(pairing.title)
            if len(titles) == count:
                raise Stop

        return titles, heard

    expected = run(["expert", "idle"])
    titles, heard = stop_after(3)
    with pytest.raises(Stop):
        run(["expert", "idle"], output=tmp_path, on_pairing=heard)
    later, heard = stop_after(99)
    went_on = run(["expert", "idle"], output=tmp_path, on_pairing=heard)
    assert len(titles) == 3 and len(later) == 1 and not set(titles) & set(later)
    assert went_on.to_json() == expected.to_json()
    more, heard = stop_after(99)
    run(["random", "idle", "expert"], output=tmp_path, on_pairing=heard)
    assert len(more) == 5 and all("random" in title for title in more)


def test_functions_are_played_anew(run, tmp_path):
    played = []
    for _ in range(2):
        policies = {"idle": "idle", "mine": rising}
        run(policies, output=tmp_path, on_pairing=played.append)
    assert len(played) == 4 + 3


def test_what_is_kept_of_something_else_is_refused(run, carry, network, tmp_path):
    path, folder = network(carry(), "mine.safetensors"), tmp_path / "kept"
    run([path, "idle"], output=folder)
    network(carry(), "mine.safetensors", seed=1)
    with pytest.raises(ValueError, match=r"the player '.*mine.safetensors' has ch"):
        run([path, "idle"], output=folder)
    with pytest.raises(ValueError, match="episodes is 4, not 5; choose another"):
        run(["expert", "idle"], output=folder, episodes=4)
    with pytest.raises(ValueError, match=r"height is 0\.7, not 0\.6"):
        run(["expert", "idle"], carry(height=0.7), output=folder)
    (kept,) = folder.glob("pairings/idle_idle-*.json")
    whole = kept.read_text()
    assert '"completion": [0.0' in whole
    for text in (
        whole[:100],
        whole.replace('"completion": [0.0', '"completion": [1.0'),
    ):
        kept.write_text(text)
        with pytest.raises(ValueError, match=r"idle_idle-.*is damaged.*played again"):
            run(["expert", "idle"], output=folder)
    kept.unlink()
    assert len(run(["expert", "idle"], output=folder).pairings) == 4


def test_a_file_that_vanishes_is_played_on(run, carry, network, tmp_path):
    path = network(carry(), "mine.safetensors")
    expected = run([path, "idle"])
    played = run(
        [path, "idle"],
        output=tmp_path / "kept",
        on_pairing=lambda _: path.unlink(missing_ok=True),
    )
    assert played.to_json() == expected.to_json()
    with pytest.raises(FileNotFoundError, match="no policy file"):
        run([path, "idle"], output=tmp_path / "kept")
    assert len(list((tmp_path / "kept" / "pairings").iterdir())) == 4


def test_a_full_disk_loses_nothing(run, tmp_path, monkeypatch):
    written = []

    def write(path, text):
        if len(written) == 2:
            raise OSError("cannot write it: No space left on device")
        written.append(path)
        path.write_text(text)

    with monkeypatch.context() as full:
        full.setattr(playing, "write_text", write)
        with pytest.raises(OSError, match="No space left"):
            run(["expert", "idle"], output=tmp_path)
    titles = []
    run(
        ["expert", "idle"], output=tmp_path, on_pairing=lambda p: titles.append(p.title)
    )
    assert len(titles) == 2
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="cannot write"):
        run(["expert", "idle"], output=tmp_path / "file")


KILLED = """
import os, signal, sys
import collaborative_gym as cg
titles = []
def heard(pairing):
    titles.append(pairing.title)
    if len(titles) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
cg.tournament("Poke", ["idle", "frozen"], episodes=2, num_threads=1,
              output=sys.argv[1], on_pairing=heard)
"""


def test_a_kill_loses_nothing(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)], env=os.environ, timeout=300
    )
    assert done.returncode == -signal.SIGKILL
    titles = []
    went_on = cg.tournament(
        "Poke",
        ["idle", "frozen"],
        episodes=2,
        num_threads=1,
        output=tmp_path,
        on_pairing=lambda pairing: titles.append(pairing.title),
    )
    assert len(titles) == 2 and len(went_on.pairings) == 4


def test_progress_grows_to_one(run):
    shares = []
    run(["idle", "expert"], episodes=2, on_progress=shares.append)
    assert shares == sorted(shares) and shares[0] > 0.0 and shares[-1] == 1.0
