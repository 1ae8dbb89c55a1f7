"""Policies that play beside those who learn, drawn when an episode starts."""

from pathlib import Path

import numpy as np
import pytest
import torch

import collaborative_gym as cg
from collaborative_gym.envs.world import World
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.casting import Casting, make_casting
from collaborative_gym.learning.collector import Collector, Job
from collaborative_gym.learning.config import FAULTS
from collaborative_gym.learning.pool import Pool, read_guests
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.team import make_learners

WORLDS, STEPS = 8, 30
NOTHING = Assistance(0.0)


@pytest.fixture
def opponents(train_tiny, duel, tmp_path):
    """Return the folders of two runs."""
    folders = [tmp_path / f"opponent_{seed}" for seed in (0, 1)]
    for seed, folder in enumerate(folders):
        train_tiny(folder, task=duel, seed=seed)
    return [str(folder) for folder in folders]


@pytest.fixture
def collect(duel, tiny):
    """Return a function that makes a collector beside guests, and one that collects."""
    made = []

    def make(words, mode="shared", seed=0, **changes):
        exact = dict.fromkeys(FAULTS, 0.0) | changes
        numbers = tiny(num_envs=WORLDS, rollout_steps=STEPS, **exact)
        casting = make_casting(duel, words, (), hyperparameters=numbers)
        sizes = World.of(duel).definition.layout
        learners = make_learners(
            mode, sizes, duel.sides, seats=casting.learned("") or None
        )
        made.append(Collector(Job(duel, learners, sizes, seed, numbers, 1, casting)))
        with torch.random.fork_rng():
            torch.manual_seed(0)
            pupils = [
                PPOLearner(each, sizes, numbers, "cpu", casting) for each in learners
            ]
        actors = {each.learner.name: each.acting() for each in pupils}
        pool = Pool(casting, read_guests(duel, casting, words))
        invitation = pool.invitation(pupils[0].weights)
        return made[-1], lambda i: made[-1].collect(actors, i, NOTHING, invitation)[0]

    yield make
    for collector in made:
        collector.close()


def test_casts_share_the_worlds_and_neighbours_differ():
    casting = Casting(
        {"a": ("robot_1",), "b": ("robot_2",)},
        (("x", "x"), ("x", None), (None, "x")),
        (0.5, 0.25, 0.25),
    )
    spread = casting.spread(8)
    assert [spread.count(cast) for cast in casting.casts] == [4, 2, 2]
    assert spread[:4] == spread[4:]
    assert casting.members == ("x",)
    assert list(casting.guests()) == [("x", "b"), ("x", "a")]
    with pytest.raises(ValueError, match="2 worlds are too few for 3 teams of players"):
        casting.check(2)


def test_guests_play_their_policies_for_whole_episodes(
    collect, opponents, duel, monkeypatch
):
    collector, advance = collect(opponents)
    env, played = collector.env, []
    guests, step = collector._guests, env.step

    def spied(actions):
        before, seen = [tuple(names) for names in guests.names], env._observations
        outcome = step(actions)
        played.append((before, seen, actions, outcome[-1]["ended"]))
        return outcome

    monkeypatch.setattr(env, "step", spied)
    collected = advance(0)
    policies = {name: cg.load_policy(name) for name in opponents}
    changed = 0
    for t, (names, seen, actions, ended) in enumerate(played):
        for world in range(WORLDS):
            learner, guest = (0, 1) if world % 2 == 0 else (1, 0)
            assert names[world][learner] == ""
            agent = duel.agents[guest]
            row = {a: each[world : world + 1] for a, each in seen.items()}
            expected = policies[names[world][guest]](row)[agent]
            np.testing.assert_array_equal(actions[agent][world], expected[0])
            if t + 1 < STEPS and played[t + 1][0][world] != names[world]:
                assert ended[world]
                changed += 1
    drawn = {names[i] for each, *_ in played for names in each for i in (0, 1)}
    assert drawn == {"", *opponents} and changed
    assert len(collected.seated) == len(collected.episodes) > 0


def test_only_the_learners_seats_are_learned_from(collect, opponents):
    _, advance = collect(opponents)
    rollout = advance(0).rollouts["shared"]
    # Half of the worlds from either seat.
    assert rollout.rewards.shape == (STEPS, WORLDS)
    index = rollout.observations[0, :, -2:]
    assert index.tolist() == [[1, 0]] * 4 + [[0, 1]] * 4
    _, advance = collect(opponents, "collaborative")
    rollouts = advance(0).rollouts
    assert {name: each.rewards.shape for name, each in rollouts.items()} == {
        "side_1": (STEPS, 4),
        "side_2": (STEPS, 4),
    }


def test_guests_advise_what_they_would_do_in_the_learners_place(
    collect, opponents, duel
):
    words = ["expert", "idle", "expert:slow", opponents[0]]
    collector, advance = collect(words, imitation=1.0)
    player, seen = collector._players[0], []
    act, env = player.act, collector.env

    def spied(observations, *given):
        policies = {word: cg.load_policy(word, env) for word in words if word != "idle"}
        would = {word: each(observations) for word, each in policies.items()}
        expected = np.full((WORLDS, player.noise.shape[1]), np.nan, np.float32)
        for row, world in enumerate([*range(0, WORLDS, 2), *range(1, WORLDS, 2)]):
            seat, names = int(row >= WORLDS // 2), collector._guests.names[world]
            if (guest := names[1 - seat]) != "idle":
                expected[row] = would[guest][duel.agents[seat]][world]
        seen.append(expected)
        return act(observations, *given)

    player.act = spied
    advice = advance(0).rollouts["shared"].advice
    np.testing.assert_allclose(advice, seen, atol=1e-6)
    assert np.isnan(seen).any() and not np.isnan(seen).all()


def test_the_expert_advises_where_no_guests_are(collect):
    _, advance = collect((), imitation=1.0)
    assert np.isfinite(advance(0).rollouts["shared"].advice).all()


def test_draws_are_the_runs_own_and_part_of_its_state(collect, opponents, same):
    first, advance = collect(opponents)
    advance(0)
    state = first.state_dict()
    expected, seated = advance(1), first._guests.names
    second, advance = collect(opponents)
    second.load_state_dict(state)
    found = advance(1)
    assert same(vars(found.rollouts["shared"]), vars(expected.rollouts["shared"]))
    assert found.seated == expected.seated and second._guests.names == seated
    third, advance = collect(opponents, seed=1)
    advance(0)
    assert third.state_dict()["0"]["seated"] != state["0"]["seated"]


@pytest.mark.parametrize("mode", ["collaborative", "independent", "shared"])
def test_a_best_response_serves_both_seats(
    train_tiny, tiny, duel, opponents, mode, read_progress
):
    result = train_tiny(
        task=duel, mode=mode, opponent=[opponents[0], "idle"], hyperparameters=tiny()
    )
    assert result.settings.opponents == (opponents[0], "idle")
    assert result.policy().agents == ("robot_1", "robot_2")
    validated = [
        row for row in read_progress(result.folder) if "validation/points" in row
    ]
    assert len(validated) == 2
    best = max((r["validation/points"], r["validation/return"]) for r in validated)
    assert (result.best["validation/points"], result.best["validation/return"]) == best


def test_a_validation_is_what_evaluations_of_each_pairing_say(
    train_tiny, tiny, duel, opponents
):
    numbers = tiny(validation_episodes=4, validation_interval=0)
    result = train_tiny(task=duel, opponent=opponents, hyperparameters=numbers)
    assert result.settings.mode == "shared"
    policy, returns = result.policy(), []
    pairings = [
        ({"robot_1": policy, "robot_2": opponents[0]}, "side_1"),
        ({"robot_1": policy, "robot_2": opponents[1]}, "side_1"),
        ({"robot_1": opponents[0], "robot_2": policy}, "side_2"),
        ({"robot_1": opponents[1], "robot_2": policy}, "side_2"),
    ]
    for i, (team, side) in enumerate(pairings):
        report = cg.evaluate(duel, team, episodes=4, seed=1 << 41, num_threads=1)
        returns.append(report.episodes[i][f"{side}/return"])
    assert result.best["validation/return"] == pytest.approx(np.mean(returns))


def test_a_run_among_guests_goes_on_as_if_it_had_not_stopped(
    train_tiny, duel, opponents, tmp_path
):
    def interrupt(row, best):
        if row["steps"] >= 96:
            raise KeyboardInterrupt

    options = {"task": duel, "opponent": opponents, "checkpoint_interval": 64}
    whole = train_tiny(tmp_path / "whole", **options)
    with pytest.raises(KeyboardInterrupt):
        train_tiny(tmp_path / "cut", on_row=interrupt, **options)
    given, other = (Path(each, "policy.safetensors") for each in opponents)
    kept = given.read_bytes()
    given.write_bytes(other.read_bytes())
    with pytest.raises(ValueError, match="has changed since this run began; bring"):
        train_tiny(resume=tmp_path / "cut", task=duel)
    given.unlink()
    with pytest.raises(FileNotFoundError, match=r"opponent '.*': .* has no policy"):
        train_tiny(resume=tmp_path / "cut", task=duel)
    given.write_bytes(kept)
    cut = train_tiny(resume=tmp_path / "cut", task=duel)
    files = [each.folder / "policy.safetensors" for each in (whole, cut)]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_partner_may_be_any_of_several(train_tiny, carry):
    result = train_tiny(partner=["idle", "expert"])
    assert result.policy().agents == ("robot_1", "robot_2")
    assert result.settings.mode == "collaborative"


@pytest.mark.parametrize("mode", ["collaborative", "independent", "shared"])
def test_all_pairs_of_a_population_learn(train_tiny, tiny, mode, carry):
    result = train_tiny(
        mode=mode, partner="population", hyperparameters=tiny(population=2)
    )
    players = [cg.load_policy(f"{result.folder}/{name}") for name in ("1", "2")]
    assert all(policy.agents == ("robot_1", "robot_2") for policy in players)
    rows = {a: np.ones((1, n)) for a, n in players[0].layout.observation_sizes.items()}
    first, second = (policy(rows)["robot_1"] for policy in players)
    assert not np.array_equal(first, second)
    with pytest.raises(KeyError, match="no player '3'; players: 1, 2"):
        cg.load_policy(f"{result.folder}/3")


@pytest.mark.parametrize(
    ("sided", "options", "message"),
    [
        (False, {"opponent": "self"}, "Carry has one side, so there is no opponent"),
        (
            True,
            {"partner": "idle"},
            "Duel has 2 sides; name whom to play against as opponent",
        ),
        (True, {"opponent": ["self", "idle"]}, "self stands alone, got self idle"),
        (False, {"partner": ["population", "idle"]}, "population stands alone"),
        (True, {"opponent": {"side_3": "idle"}}, "no side 'side_3' .*; sides: side_1"),
        (True, {"opponent": ["idle", "side_1=idle"]}, "name a seat for each, or for"),
        (True, {"opponent": ["idle", "idle"]}, "opponent names idle twice"),
        (True, {"opponent": [""]}, "opponent must not be empty"),
        (True, {"opponent": "nowhere.safetensors"}, "no policy file nowhere"),
        (
            True,
            {"opponent": "PokeTaskSawyers-v0"},
            "PokeTaskSawyers-v0': this policy is",
        ),
        (False, {"partner": "idle", "mode": "centralized"}, "no seat for a partner"),
        (False, {"partner": "population", "mode": "centralized"}, "no seat for a part"),
        (False, {"partner": "population"}, "4 worlds are too few for 9 teams"),
    ],
)
def test_what_has_no_place_is_refused(
    train_tiny, duel, tmp_path, sided, options, message
):
    task = {"task": duel} if sided else {}
    with pytest.raises((KeyError, OSError, ValueError), match=message):
        train_tiny(**task, **options)
    assert not list(tmp_path.iterdir())
