"""Starts: each draw spreads over its bounds, and the outermost can be solved."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import rng
from collaborative_gym.tasks.registry import make_task

ONE_SIDED = [name for name in cg.list_envs() if len(make_task(name).sides) == 1]

STARTS = 150
NONE = cg.Randomization(0.0, 0.0, 0.0, 0.0)


def yaw(quat):
    return 2.0 * np.arctan2(quat[:, 3], quat[:, 0])


def turns(quat, nominal):
    """Return how far about the vertical from the nominal orientation, in rad."""
    return yaw(cg.math.multiply(quat, cg.math.conjugate(nominal)))


def moved(pose, nominal, axes=3):
    """Return what the randomization may do to an object, by its field."""
    return {
        "object_position": (pose[0] - nominal[0])[:, :axes],
        "object_yaw": turns(pose[1], nominal[1])[:, None],
    }


def drawn(env_id, facts, nominal):
    """Return by field how far starts are from the nominal one, (starts, k) each."""
    if env_id.startswith("Poke"):
        both = [moved(facts.stick, nominal.stick), moved(facts.donut, nominal.donut)]
        found = {name: np.hstack([one[name] for one in both]) for name in both[0]}
    elif env_id.startswith("Lift"):
        found = moved(facts.pot, nominal.pot, axes=2)
    elif env_id.startswith("Balance"):
        found = moved(facts.board, nominal.board)
    elif env_id.startswith("Reach"):
        goals = [facts.goals[agent] - nominal.goals[agent] for agent in facts.goals]
        found = {"target_position": np.hstack(goals)}
    elif env_id.startswith("Assemble"):
        pairs = [(facts.parts[a], nominal.parts[a]) for a in facts.parts]
        each = [moved(*pair, axes=2) for pair in pairs]
        found = {name: np.hstack([one[name] for one in each]) for name in each[0]}
    elif env_id.startswith("Sort"):
        far = facts.cubes - nominal.cubes
        # Of two cubes in a lane either comes first, 0.65 m before the other.
        far[..., 0] = (far[..., 0] + 0.325) % 0.65 - 0.325
        across = far * [1.0, 2.0, 0.0]
        found = {"object_position": across[..., :2].reshape(STARTS, -1)}
    else:
        first, own = ([x[:, 0] for x in each.cubes] for each in (facts, nominal))
        found = moved(first, own, axes=2)
        # In a relay they lie on a table.
        axes = 3 if len(facts.tcp) == 2 else 2
        targets = (facts.targets - nominal.targets)[..., :axes]
        found["target_position"] = targets.reshape(STARTS, -1)
    if hasattr(facts, "target"):
        found["target_position"] = facts.target - nominal.target
    own = [facts.joints[a] - nominal.joints[a] for a in facts.joints]
    return {**found, "joint_noise": np.hstack(own)}


def starts(task, **bounds):
    """Return worlds at starts that are drawn within these bounds alone."""
    chosen = cg.Randomization(**{**vars(NONE), **bounds})
    env = cg.VectorEnv(task.varied(randomization=chosen), STARTS, num_threads=1)
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("env_id", ONE_SIDED)
def test_each_draw_spreads_over_its_bounds(env_id):
    task = cg.task(env_id)
    nominal = starts(task).facts
    for field in drawn(env_id, nominal, nominal):
        bound = getattr(cg.Randomization(), field)
        facts = starts(task, **{field: bound}).facts
        found = drawn(env_id, facts, nominal)[field] / bound
        if env_id.startswith("Balance") and field == "joint_noise":
            # Joints that hold the board keep only what leaves their hand where it is.
            by_arm = found.reshape(STARTS, -1, 7)
            assert (np.abs(by_arm).max(axis=(0, 2)) > 0.5).all()
            continue
        # Poke's objects go where the joints bring them, right to first order only: a
        # turn of 15 degrees comes out as 12.5 one way and as 17 the other.
        is_poke = env_id.startswith("Poke")
        least, most = (0.8, 1.5) if is_poke else (0.9, 1.001)
        # Of some draws Reach takes the first that is apart from other goals.
        wide = 0.9
        if env_id.startswith("Reach") and field == "target_position":
            least = wide = 0.7
        low, high = found.min(axis=0), found.max(axis=0)
        assert ((high - low) / 2 > wide).all(), field
        assert (high > least).all() and (low < -least).all(), field
        assert np.abs(found).max() < most, field


def test_the_ball_starts_anywhere_and_is_pushed_either_way():
    env = starts(cg.task("BalanceTaskSawyers-v0"))
    share = env.facts.offset[:, :2] / [0.2, 0.45]
    assert (share.max(axis=0) > 0.9).all()
    assert (share.min(axis=0) < -0.9).all()
    push = env.sim.memory["pushes"] / [10.0, 0.4, 0.75]
    assert (push.max(axis=(0, 1)) > 0.9).all()
    assert (push.min(axis=(0, 1)) < -0.9).all()
    assert np.abs(push).max() <= 1.0


class Corners:
    """Draws at the bounds: the k-th is at the upper one if bit k % 6 of the episode is.

    So 64 episodes have all patterns of six successive draws. From the 21st on they lie
    nearer to the middle, where a start that is drawn anew is free at last.
    """

    def __init__(self, seed, episode, stream):
        self._episode, self._drawn = int(episode), 0

    def random(self, shape):
        draws = self._drawn + np.arange(np.prod(shape, dtype=int))
        self._drawn += len(draws)
        upper = (self._episode >> draws % 6 & 1).astype(float)
        return (0.5 + (upper - 0.5) * 0.97 ** (draws // 20)).reshape(shape)


@pytest.mark.parametrize("env_id", ONE_SIDED)
def test_the_expert_solves_the_outermost_starts(env_id, monkeypatch):
    monkeypatch.setattr(rng, "episode_generator", Corners)
    # Of teams fewer corners, because they take long.
    arms = len(make_task(env_id).agents)
    corners = 64 if arms == 2 else 16 if arms <= 4 else 8
    env = cg.make_vec(env_id, num_envs=corners, num_threads=1)
    env.reset(seed=0)
    reached = np.zeros(corners, bool)
    for _ in range(env.task.config.max_episode_steps):
        reached |= env.step(env.expert())[4]["success"]
        if reached.all():
            break
    # With all joints at their bounds at once, a Jaco's wrist may start at its ends, and
    # eight arms are in one another's way.
    most = {"LiftTaskJacos-v0": 3, "ReachPandas8-v0": 5}.get(env_id, 0)
    assert (~reached).sum() <= most, np.flatnonzero(~reached)
