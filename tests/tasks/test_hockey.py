"""Hockey: bounces, walls, goals, serves, fouls, seats that are alike, the player."""

from dataclasses import replace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.objects.puck import RADIUS
from collaborative_gym.objects.rink import HALF_LENGTH
from collaborative_gym.tasks.experts.hockey_player import Field, foresee, play
from collaborative_gym.timing import SIM_DT, SUBSTEPS

IDS = [f"Hockey{arms}-v0" for arms in ("Pandas", "Sawyers", "PandaSawyer", "Doubles")]
FIELD = Field(0.32, 0.2, 0.8)


def make(num_envs=1, env_id="HockeyPandas-v0", **options):
    env = cg.make_vec(env_id, num_envs, seed=0, num_threads=1, **options)
    env.reset()
    return env


def put(env, place, velocity=(0.0, 0.0)):
    """Put the pucks somewhere, and let the task see it."""
    for i, axis in enumerate("xy"):
        joint = env.model.joint(f"puck/{axis}")
        env.sim.qpos[:, int(joint.qposadr[0])] = np.asarray(place, float)[..., i]
        env.sim.qvel[:, int(joint.dofadr[0])] = np.asarray(velocity, float)[..., i]


def watched(env, steps, actions=None):
    """Return place and velocity of the pucks at every physics step that follows."""
    seen = []

    def look():
        env.sim.forward()
        puck = env.sim.pose("puck")[0], env.sim.velocity("puck")[0]
        seen.append(np.stack([part[:, :2] for part in puck]))

    env.watch(look, shots=SUBSTEPS)
    for _ in range(steps):
        env.step(env.idle() if actions is None else actions(env))
    env.watch(None)
    return np.moveaxis(np.array(seen), 1, 0)


@pytest.mark.parametrize("is_refined", [False, True])
@pytest.mark.parametrize("restitution", [0.5, 0.8, 1.0])
def test_a_cushion_returns_the_share_of_the_speed_that_was_set(restitution, is_refined):
    env = make(8, restitution=restitution)
    if is_refined:
        env.sim.refinement = replace(
            env.sim.refinement, strays=lambda qpos, _: np.ones(qpos.shape[:-1], bool)
        )
    phase = np.arange(8) / 8
    for speed in (0.3, 1.0, 2.5):
        y = 0.32 - RADIUS - 0.03 - speed * SIM_DT * phase
        place = np.stack([np.zeros(8), y], axis=1)
        put(env, place, (0.4 * speed, speed))
        places, speeds = watched(env, 2)
        first = np.argmax(speeds[..., 1] < 0, axis=0)
        worlds = np.arange(8)
        share = -speeds[first, worlds, 1] / speeds[first - 1, worlds, 1]
        np.testing.assert_allclose(share, restitution, rtol=0.03)
        np.testing.assert_allclose(speeds[first, :, 0], 0.4 * speed, rtol=0.05)
        # As deep as it moves in a step, not more.
        assert places[..., 1].max() < 0.32 - RADIUS + 1.01 * speed * SIM_DT


def test_no_shot_leaves_the_table_or_goes_through_a_mallet():
    env, rng = make(12), np.random.default_rng(0)
    arms = {a: space.shape for a, space in env.single_action_spaces.items()}

    def wild(env):
        return {a: np.sign(rng.uniform(-1, 1, (12, *n))) for a, n in arms.items()}

    for speed in (4.0, 8.0, 12.0):
        place = rng.uniform(-1, 1, (12, 2)) * (HALF_LENGTH - 0.1, 0.2)
        angle = rng.uniform(0, 2 * np.pi, 12)
        put(env, place, speed * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        places, _ = watched(env, 4, wild)
        x, y = np.abs(places[..., 0]), np.abs(places[..., 1])
        assert y.max() < 0.32 + 2 * RADIUS
        assert x[y > 0.2 + RADIUS].max() < HALF_LENGTH + 2 * RADIUS
        assert x.max() < HALF_LENGTH + 0.25


def test_a_mallet_in_the_way_stops_a_fast_shot():
    env = make(8)
    mallet = env.facts.mallet["robot_1"][0]
    for speed in (1.0, 4.0, 8.0):
        env.reset(seed=0)
        gap = 0.2 + SIM_DT * speed * np.arange(8) / 8
        start = mallet[:, :2] + np.stack([gap, 0.0 * gap], axis=1)
        put(env, start, (-speed, 0.0))
        places, speeds = watched(env, 3 if speed < 2.0 else 1)
        behind = places[..., 0] < mallet[:, 0]
        assert not behind.any()
        assert (speeds[-1, :, 0] > 0).all()


def test_a_goal_counts_once_and_the_conceder_is_served():
    env = make(2)
    put(env, [[0.5, 0.06], [-0.5, 0.06]], [[3.0, 0.0], [-3.0, 0.0]])
    env.sim.forward()
    score = {side: np.zeros(2) for side in env.sides}
    for _ in range(4):
        infos = env.step(env.idle())[-1]
        for side, met in infos["success"].items():
            score[side] += met
    assert score["side_1"].tolist() == [1, 0] and score["side_2"].tolist() == [0, 1]
    assert infos["metrics"]["score"]["side_1"].tolist() == [1.0, 0.0]
    assert infos["metrics"]["completion"]["side_2"].tolist() == [0.0, 1.0]
    assert (infos["metrics"]["performance"]["side_1"] > [0.2, -1.0]).all()
    assert np.sign(env.facts.puck[:, 0]).tolist() == [1, -1]
    assert env.facts.lead.tolist() == [1, -1]
    terms = infos["metrics"]["reward_terms"]
    assert [float(terms[a]["goal"][0]) for a in env.agents] == [10.0, -10.0]


def test_own_goals_count():
    env = make()
    put(env, (-0.54, 0.1), (-2.0, 0.0))
    infos = env.step(env.idle())[-1]
    assert infos["success"]["side_2"].all() and not infos["success"]["side_1"].any()


def test_a_puck_that_nobody_plays_is_a_foul_after_a_while():
    env = make(1, foul_after=1.0)
    put(env, (-0.49, 0.26))
    env.sim.forward()
    sides = []
    for _ in range(14):
        env.step(env.idle())
        sides.append(float(np.sign(env.facts.puck[0, 0])))
    assert sides[:8] == [-1.0] * 8
    assert sides[-2:] == [1.0, 1.0]
    assert not env.facts.lead.any() and env.facts.clock[0] < 0.5


def test_a_serve_avoids_mallets():
    env = make(64)
    task = env.task
    env.sim.memory["serves"][:, 1, :3] = [0.0, 0.2, -0.2]
    env.sim.memory["call"] = np.where(np.arange(64) % 2, 1.0, -1.0)
    real, here = env.sim.pose, np.zeros((64, 3))
    here[:32, 1] = 0.03
    env.sim.pose = lambda name: (here, 0) if "mallet" in name else real(name)
    task.disturb(env.sim, np.zeros(64, int))
    y = env.sim.qpos[:, int(env.model.joint("puck/y").qposadr[0])]
    assert np.abs(y).tolist() == [0.2] * 64


def opposite(env):
    """Return pairs of an agent and that in its place on the other side."""
    one, two = env.sides.values()
    return [*zip(one, two, strict=True), *zip(two, one, strict=True)]


def turned(env, other):
    """Put what the worlds of `env` are, turned by half a turn, into `other`."""
    state = env.get_state()
    for name in ("x", "y"):
        joint = env.model.joint(f"puck/{name}")
        at, dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        other.sim.qpos[:, at] = -env.sim.qpos[:, at]
        other.sim.qvel[:, dof] = -env.sim.qvel[:, dof]
    for one, two in opposite(env):
        arm, seat = env.scene.arms[one], other.scene.arms[two]
        other.sim.qpos[:, seat.qpos] = env.sim.qpos[:, arm.qpos]
        there, here = (env.model.actuator_actadr[own.servos] for own in (seat, arm))
        other.sim.act[:, there] = env.sim.act[:, here]
    other.sim.memory["serves"] = env.sim.memory["serves"].copy()
    other.sim.memory["half"] = -env.sim.memory["half"]
    other.sim.forward()
    assert len(state.physics) == env.num_envs


@pytest.mark.parametrize("env_id", [IDS[0], IDS[-1]])
def test_swapped_seats_mirror_the_episode(env_id):
    env, other = make(4, env_id), make(4, env_id)
    turned(env, other)
    one = env.step(env.idle())
    two = other.step(other.idle())
    # Rounding differs between the seats, and grows with every bounce.
    for step in range(40):
        for agent, seat in opposite(env):
            np.testing.assert_allclose(
                one[0][agent], two[0][seat], atol=1e-4, err_msg=f"{step} {agent}"
            )
        mine, yours = env.expert(), other.expert()
        for agent, seat in opposite(env):
            np.testing.assert_allclose(mine[agent], yours[seat], atol=1e-4)
        one, two = env.step(mine), other.step(yours)


@pytest.mark.parametrize("env_id", IDS)
def test_goals_add_up_to_zero(env_id):
    env = make(2, env_id)
    put(env, (0.54, 0.0), (2.0, 0.0))
    infos = env.step(env.expert())[-1]
    terms = infos["reward_terms"]
    total = sum(terms[agent]["goal"] for agent in env.agents)
    assert terms["robot_1"]["goal"].all() and not total.any()


def test_pairs_have_lanes_of_their_own():
    env = make(1, "HockeyDoubles-v0")
    assert env.sides == {
        "side_1": ("robot_1", "robot_2"),
        "side_2": ("robot_3", "robot_4"),
    }
    places = [env.facts.mallet[agent][0][0, :2] for agent in env.agents]
    np.testing.assert_allclose(places[0], -places[2], atol=0.11)
    assert places[1][1] - places[0][1] > 0.5
    mixed = make(1, "HockeyDoubles-v0", robots=("panda", "jaco", "sawyer", "panda"))
    assert mixed.single_action_spaces["robot_2"].shape == (7,)


def test_the_player_foresees_cushions():
    puck, velocity = np.array([[0.0, 0.0]]), np.array([[0.0, 1.0]])
    ways = foresee(FIELD, puck, velocity)
    assert ways[5, 0, 1] == pytest.approx(0.25)
    assert ways[:, 0, 1].max() < 0.32 - RADIUS + 1e-9
    # From 0.27 m back by 0.8 of the way that was left, and once more from the other.
    assert ways[-1, 0, 1] == pytest.approx(-0.27 + 0.8 * (0.8 * 0.73 - 0.54), abs=0.01)


def test_the_player_blocks_hits_and_waits():
    own, others = np.array([[[-0.3, 0.0]]]), np.array([[[0.4, 0.0]]])

    def asked(place, velocity):
        puck = np.array([place]), np.array([velocity])
        goals, hits = play(FIELD, own, np.zeros(1), others, puck)
        return goals[0, 0], bool(hits[0, 0])

    goal, hits = asked((0.1, 0.05), (-2.0, 0.1))
    assert goal[0] < -0.4 and 0.05 < goal[1] < 0.12 and not hits
    goal, hits = asked((0.4, 0.2), (0.0, 0.0))
    assert goal[0] < -0.35 and 0.0 < goal[1] < 0.2 and not hits
    goal, hits = asked((-0.1, 0.1), (0.0, 0.0))
    assert goal[0] < -0.15
    assert not hits


@pytest.mark.slow
def test_the_player_beats_one_that_holds_still():
    env = make(16, max_episode_steps=301)
    for _ in range(300):
        infos = env.step({**env.idle(), "robot_2": env.expert()["robot_2"]})[-1]
    score = infos["metrics"]["score"]
    assert (score["side_2"] > score["side_1"]).mean() > 0.6
    assert score["side_2"].mean() > 3 * score["side_1"].mean()
