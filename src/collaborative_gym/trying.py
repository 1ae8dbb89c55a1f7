"""Trials of an arm in tasks, and what in its definition may be wrong."""

from collections import Counter

import mujoco
import numpy as np

from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.motion.solver import DAMPING
from collaborative_gym.robots import Robot
from collaborative_gym.robots.checks import at_home
from collaborative_gym.tasks.registry import as_task

_LOOKS = 10  # control steps from one look at what hinders arms to the next
_AT_END, _NEAR_END = 0.03, 0.1  # rad from the end of a joint's range: there, or near it
_SLOW = 0.3  # rad/s below which a joint hardly gets anywhere within an episode
_ROOM = 0.02  # m, half the width of Pass's cube


def try_robot(robot: Robot, task: str, episodes: int) -> tuple[float, str]:
    """Return the share of episodes that the expert completes with such arms, and why.

    The reason is a sentence, or empty. Where not all sides can win, the share is of the
    episodes whose physics is sound.
    """
    try:
        env = VectorEnv(as_task(task, robot), episodes, num_threads=1, auto_reset=False)
        env.reset(seed=0)
    except (ValueError, NotImplementedError) as error:
        return 0.0, f"{task} cannot be made: {error}"
    seen: list[Counter[str]] = [Counter() for _ in range(episodes)]
    for step in range(env.task.config.max_episode_steps):
        *_, infos = env.step(env.expert())
        if step % _LOOKS == 0:
            for i, counter in enumerate(seen):
                counter.update(_hindrances(env, i))
        if infos["ended"].all():
            break
    sound = ~np.asarray(infos["diverged"])
    met = sound if len(env.sides) > 1 else infos["metrics"]["completion"] > 0.0
    env.close()
    if met.all():
        return 1.0, ""
    told = f"{task}: the expert completes {met.sum()} of {episodes} episodes"
    if not sound.all():
        told += f"; physics diverges in {(~sound).sum()}"
    failed = [seen[i] for i in np.flatnonzero(~met)]
    often = sum(failed, Counter[str]()).most_common()
    found = [w for w, _ in often if 2 * sum(w in own for own in failed) > len(failed)]
    if found:
        told += f"; in most of the failures {' and '.join(found[:2])}"
    return float(met.mean()), told


def _hindrances(env: VectorEnv, world: int) -> set[str]:
    """Return contacts of arms, joints at an end and singular postures, in words."""
    data, model, found = env.sim.data(world), env.model, set()
    for contact in data.contact:
        names = [model.body(int(model.geom_bodyid[g])).name for g in contact.geom]
        if contact.dist < 0.0 and any(n.split("/")[0] in env.agents for n in names):
            found.add(f"{names[0]} touches {names[1]}")
    for agent, arm in env.scene.arms.items():
        (low, high), angles = arm.joint_range, data.qpos[arm.qpos]
        ends = np.minimum(angles - low, high - angles) < _AT_END
        for name in np.array(arm.robot.joints)[ends]:
            found.add(f"{agent}'s {name} is at the end of its range")
        mujoco.mj_jacSite(model, data, rows := np.zeros((3, model.nv)), None, arm.tcp)
        if np.linalg.svd(rows[:, arm.dof])[1][-1] < DAMPING:
            found.add(f"{agent} is in a singular posture, as an outstretched arm is")
    return found


def unusual(robot: Robot) -> list[str]:
    """Return likely faults of an arm's definition, in sentences."""
    site = (spec := robot.spec()).site(robot.tcp)
    probe = {"name": "probe of the tcp", "contype": 0, "conaffinity": 0, "mass": 0.0}
    site.parent.add_geom(pos=site.pos, size=[1e-5] * 3, **probe)
    data = at_home(robot, model := spec.compile(), robot.gripper.open_position)
    tip, nearest = model.geom(probe["name"]).id, (_ROOM, "")
    for geom in np.flatnonzero(model.geom_contype | model.geom_conaffinity):
        gap = mujoco.mj_geomDistance(model, data, tip, int(geom), _ROOM, None)
        nearest = min(nearest, (gap, model.body(int(model.geom_bodyid[geom])).name))
    gap, found = round(1000 * nearest[0]), []
    if nearest[1]:
        where = f"{abs(gap)} mm {'inside' if gap < 0 else 'from'}" if gap else "on"
        found.append(f"its tcp is {where} its {nearest[1]}, which may be in the way")
    tcp = data.site(robot.tcp)
    if (behind := -tcp.xpos[0]) > 0.0:
        found.append(f"at home its hand is {behind:.2f} m behind its base")
    if tcp.xmat[8] > 0.5:
        found.append("at home its hand points up")
    rows = zip(robot.joints, robot.home, robot.velocity_limits, strict=True)
    for name, angle, fastest in rows:
        if fastest < _SLOW:
            found.append(f"{name} turns at most {fastest:g} rad/s")
        room = np.abs(model.joint(name).range - angle).min()
        if room < _NEAR_END:
            found.append(f"at home {name} is {room:.2f} rad from the end of its range")
    return found
