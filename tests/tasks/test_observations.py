"""Every number of an observation is what MuJoCo says of the thing that it names."""

import mujoco
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.tasks.assemble import PARTS
from collaborative_gym.tasks.experts.assemble import WAIT
from collaborative_gym.tasks.registry import make_task

ONE_SIDED = [name for name in cg.list_envs() if len(make_task(name).sides) == 1]

AGENTS = ("robot_1", "robot_2")
SITES = {
    "stick": "robot_1/stick/stick",
    "donut": "robot_2/donut/donut",
    "pot": "pot/pot",
    "ball": "ball/ball",
    "board": "robot_1/board/board",
    "cube": "cube/centre",
    "robot_1 handle": "pot/handle_1",
    "robot_2 handle": "pot/handle_2",
    **{f"{agent} tcp": f"{agent}/tcp" for agent in AGENTS},
    **{f"{agent} end effector": f"{agent}/tcp" for agent in AGENTS},
}
"""Where what a block shows is in the model."""


def joints(model, data, agent):
    names = [model.joint(i).name for i in range(model.njnt)]
    robot = [name for name in names if name.startswith(f"{agent}/")]
    return [data.joint(name).qpos[0] for name in robot][:7]


def pose(model, data, site):
    """Return position and quaternion x y z w of a site."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, data.site(site).xmat)
    return np.concatenate([data.site(site).xpos, quat[1:], quat[:1]])


def velocity(model, data, site):
    """Return angular, then linear velocity of a site in the world's frame."""
    found = np.zeros(6)
    kind, number = mujoco.mjtObj.mjOBJ_SITE, model.site(site).id
    mujoco.mj_objectVelocity(model, data, kind, number, found, 0)
    return found


def expected(model, data, block, agent):
    """Return what a block of an agent's observation must be."""
    owner = block.split()[0]
    if block == "joints":
        return joints(model, data, agent)
    if block.endswith("joints"):
        return joints(model, data, owner)
    if block.endswith("gripping"):
        equalities = [model.equality(i) for i in range(model.neq)]
        own = [e.id for e in equalities if e.name.startswith(f"{owner} grips")]
        return [
            data.eq_active[own].any() if own else len(touching(model, data, owner)) > 1
        ]
    if block == "target":
        return data.mocap_pos[model.body("target").mocapid[0]]
    if block == "ball linear velocity":
        return velocity(model, data, "ball/ball")[3:]
    if block == "ball angular velocity":
        return velocity(model, data, "ball/ball")[:3]
    return pose(model, data, SITES[block])


def touching(model, data, agent):
    """Return the links of an arm that touch the cube."""
    pairs = [
        {model.body(model.geom_bodyid[g]).name.split("/")[0]: g for g in pair}
        for pair in data.contact.geom
    ]
    return {model.geom_bodyid[p[agent]] for p in pairs if agent in p and "cube" in p}


def turn(angle):
    """Return the matrix of a turn about the vertical."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def seen_from_base(env, data, block, agent):
    """Return what a robot of Lift sees of the world in the frame of its base."""
    agents, placement = env.agents, env.task.placements[agent]
    i, back = agents.index(agent), turn(placement.yaw).T
    sites = [data.site(f"pot/handle_{j + 1}").xpos for j in range(len(agents))]
    gaps = [
        np.linalg.norm(data.site(f"{a}/tcp").xpos - s)
        for a, s in zip(agents, sites, strict=True)
    ]
    if block == "mates":
        rows = np.zeros((7, 4))
        for row, j in enumerate([*range(i + 1, len(agents)), *range(i)]):
            grips = expected(env.model, data, f"{agents[j]} gripping", agent)
            rows[row] = 1.0, *grips, gaps[j], (sites[j] - sites[i])[2]
        return rows.ravel()
    if block == "to_target":
        place = data.mocap_pos[env.model.body("target").mocapid[0]]
        return back @ (place - data.site("pot/pot").xpos)
    name = f"{agent}/tcp" if block == "tcp" else "pot/pot"
    spin = np.eye(3) if block == "tcp" else turn(2 * np.pi * i / len(agents))
    place = sites[i] if block == "handle" else data.site(name).xpos
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(
        quat, (back @ data.site(name).xmat.reshape(3, 3) @ spin).ravel()
    )
    return np.concatenate([back @ (place - placement.position), quat[1:], quat[:1]])


def seen_in_reach(env, data, block, agent):
    """Return what a robot of Reach sees of the world in the frame of its base."""
    agents, placement = env.agents, env.task.placements[agent]
    i, back = agents.index(agent), turn(placement.yaw).T
    tcp = data.site(f"{agent}/tcp").xpos

    def goal(name):
        return data.mocap_pos[env.model.body(f"{name} goal").mocapid[0]]

    if block == "mates":
        rows = np.zeros((7, 10))
        for row, mate in enumerate([*agents[i + 1 :], *agents[:i]]):
            places = data.site(f"{mate}/tcp").xpos, data.site(f"{mate}/elbow").xpos
            apart = [back @ (place - tcp) for place in (*places, goal(mate))]
            rows[row] = 1.0, *np.concatenate(apart)
        return rows.ravel()
    return {
        "tcp": back @ (tcp - placement.position),
        "tcp velocity": back @ velocity(env.model, data, f"{agent}/tcp")[3:],
        "goal": back @ (goal(agent) - tcp),
    }[block]


def seen_in_balance(env, data, block, agent):
    """Return what a robot of BalancePath sees of the world in its base's frame."""
    agents, placement = env.agents, env.task.placements[agent]
    i, back = agents.index(agent), turn(placement.yaw).T
    if block == "mates":
        sites = [f"robot_1/board/handle_{j + 1}" for j in range(len(agents))]
        places = [data.site(site).xpos for site in sites]
        rows = np.zeros((7, 4))
        for row, j in enumerate([*range(i + 1, len(agents)), *range(i)]):
            rows[row] = 1.0, *(back @ (places[j] - places[i]))
        return rows.ravel()
    if block.endswith("velocity"):
        return back @ expected(env.model, data, block, agent)
    place = back @ (expected(env.model, data, block, agent)[:3] - placement.position)
    if block != "board":
        return place
    quat, spin = np.zeros(4), turn(2 * np.pi * i / len(agents))
    board = data.site("robot_1/board/board").xmat.reshape(3, 3)
    mujoco.mju_mat2Quat(quat, (back @ board @ spin).ravel())
    return np.concatenate([place, quat[1:], quat[:1]])


def seen_in_pass(env, data, block, agent):
    """Return what a robot of a relay sees of the world in the frame of its base."""
    agents, base = env.agents, np.array(env.task.placements[agent].position)
    i, cube = agents.index(agent), data.site("cube/centre").xpos
    tcp = data.site(f"{agent}/tcp").xpos
    if block == "mates":
        rows = np.zeros((7, 7))
        for row, j in enumerate([*range(i + 1, len(agents)), *range(i)]):
            place = data.site(f"{agents[j]}/tcp").xpos
            grips = expected(env.model, data, f"{agents[j]} gripping", agent)
            far = fine(np.linalg.norm(place - cube))
            rows[row] = 1.0, (j - i) / 7, *grips, *(place - tcp), far
        return rows.ravel()
    if block == "to_cube":
        return fine(cube - tcp)
    if block == "to_goal":
        target = data.mocap_pos[env.model.body("target").mocapid[0]]
        goal = target if i == len(agents) - 1 else env.task.meetings[i]
        return fine(goal - cube)
    site = f"{agent}/tcp" if block == "tcp" else "cube/centre"
    return pose(env.model, data, site) - [*base, 0.0, 0.0, 0.0, 0.0]


def seen_in_sort(env, data, block, agent):
    """Return what a robot of Sort sees of the world in the frame of its base."""
    agents, placement, task = env.agents, env.task.placements[agent], env.task
    i, back = agents.index(agent), turn(placement.yaw).T
    tcp = data.site(f"{agent}/tcp").xpos
    if block == "mates":
        rows = np.zeros((7, 6))
        for row, j in enumerate([*range(i + 1, len(agents)), *range(i)]):
            grips = np.max(expected(env.model, data, f"{agents[j]} gripping", agent))
            apart = back @ (data.site(f"{agents[j]}/tcp").xpos - tcp)
            rows[row] = 1.0, (j - i) / 7, grips, *apart
        return rows.ravel()
    if block == "tcp":
        turned, quat = back @ data.site(f"{agent}/tcp").xmat.reshape(3, 3), np.zeros(4)
        mujoco.mju_mat2Quat(quat, turned.ravel())
        return np.concatenate([back @ (tcp - placement.position), quat[1:], quat[:1]])
    if block == "tote":
        floor = data.body(f"{agent}_tote/tote").xpos
        return back @ (floor - placement.position)
    whose = {"own cube": (i, -1), "mate's cube": (i + 1, i), "moved cube": (i, i - 1)}
    if whose[block] not in task.cubes:
        return np.zeros(4)
    cube = data.site(f"cube_{task.cubes.index(whose[block]) + 1}/centre").xpos
    # None is sorted, lost or moved within the 16 steps that are checked.
    return [*(back @ (cube - placement.position)), 1.0]


def seen_in_assemble(env, data, block, agent):
    """Return what a robot of Assemble sees of the world in the frame of its base."""
    agents, placement = env.agents, env.task.placements[agent]
    i, back = agents.index(agent), turn(placement.yaw).T
    if block == "inside":
        return [0.0, 0.0]  # Nothing is in the block within the steps that are checked.
    if block == "mates":
        return seen_in_sort(env, data, block, agent)
    if block == "block":
        site, body = data.site("block/block"), env.model.body("target")
        target, frame = data.mocap_pos[body.mocapid[0]], site.xmat.reshape(3, 3)
        turned = np.arccos((np.trace(frame.T @ turn(np.pi / 4)) - 1.0) / 2.0)
        return [np.linalg.norm(site.xpos - target), turned]
    sites = {"tcp": f"{agent}/tcp", "part": f"{PARTS[i]}/{PARTS[i]}"}
    seen = {name: data.site(site) for name, site in sites.items()}
    seen = {name: (x.xpos, x.xmat.reshape(3, 3)) for name, x in seen.items()}
    if block == "to_part":
        knob, hand = data.site(f"{PARTS[i]}/knob"), np.zeros(9)
        mujoco.mju_quat2Mat(hand, env.task.turns[agent])
        goal = knob.xpos, knob.xmat.reshape(3, 3) @ hand.reshape(3, 3)
        return fine(way(back, seen["tcp"], goal))
    if block == "to_goal":
        site = data.site("block/block")
        frame = site.xmat.reshape(3, 3)
        target = data.mocap_pos[env.model.body("target").mocapid[0]], turn(np.pi / 4)
        pin = site.xpos + WAIT * frame[:, 1], frame
        goals = target, (site.xpos, frame), pin
        return fine(way(back, seen["part"], goals[i]))
    (place, frame), quat = seen[block], np.zeros(4)
    mujoco.mju_mat2Quat(quat, (back @ frame).ravel())
    return np.concatenate([back @ (place - placement.position), quat[1:], quat[:1]])


def fine(way):
    """Return ways or turns by their logarithms, 1 cm or 0.01 rad as log 2."""
    return np.sign(way) * np.log(1.0 + np.abs(way) / 0.01)


def way(back, pose, goal):
    """Return the way and the turn from one place and frame to another."""
    quat, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quat, (goal[1] @ pose[1].T).ravel())
    mujoco.mju_quat2Vel(vector, quat, 1.0)
    return [*(back @ (goal[0] - pose[0])), *(back @ vector)]


@pytest.mark.parametrize("env_id", ONE_SIDED)
def test_each_block_is_what_mujoco_says(env_id):
    env = cg.make_vec(env_id, num_envs=2, num_threads=1)
    observations, _ = env.reset(seed=0)
    for step in range(16):
        if step % 5 == 0:
            check(env, observations)
        observations = env.step(env.expert())[0]
    grips = "Lift" in env_id or "Pass" in env_id
    assert env.sim.eq_active.any() or not grips, "no grip was ever seen to hold"


def check(env, observations):
    for i in range(env.num_envs):
        data = env.sim.data(i)
        for agent in env.agents:
            sizes = {n: b.size for n, b in env.observation_blocks[agent].items()}
            ends = np.cumsum(list(sizes.values()))[:-1]
            parts = np.split(observations[agent][i], ends)
            for block, part in zip(sizes, parts, strict=True):
                if block in ("target velocity", "goals left", "cubes left"):
                    # MuJoCo has none; see test_balance_path.py, test_pass_teams.py.
                    continue
                if block == "next cube":
                    facts, task = env.facts, env.task
                    own = facts.own[agent][i]
                    cube = data.site(f"cube_{own + 1}/centre").xpos
                    back = turn(task.placements[agent].yaw).T
                    is_mates = task.cubes[own].mover == env.agents.index(agent)
                    place = back @ (cube - data.site(f"{agent}/tcp").xpos)
                    wanted = [*place, is_mates, facts.near[agent][i, own]]
                elif block == "gripping" and "tote" in sizes:
                    own = expected(env.model, data, f"{agent} gripping", agent)
                    wanted = [np.max(own)]
                elif "mates" in sizes and block not in ("joints", "gripping"):
                    ways = {"cube": seen_in_pass, "goal": seen_in_reach}
                    ways |= {"board": seen_in_balance, "tote": seen_in_sort}
                    ways = {"part": seen_in_assemble, **ways}
                    look = next((ways[n] for n in ways if n in sizes), seen_from_base)
                    wanted = look(env, data, block, agent)
                else:
                    name = f"{agent} gripping" if block == "gripping" else block
                    wanted = expected(env.model, data, name, agent)
                if block == "mates" and "goals left" in sizes:
                    # MuJoCo knows neither their seats nor how many they have left.
                    part = np.delete(part.reshape(7, 12), (1, 2), axis=1).ravel()
                wanted = np.asarray(wanted, float)
                if part[3:].shape == (4,):
                    # A quaternion and its negative are one orientation.
                    wanted[3:] *= np.sign(np.dot(wanted[3:], part[3:]))
                np.testing.assert_allclose(part, wanted, atol=1e-5, err_msg=block)
