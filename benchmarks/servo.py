"""How the joint servos follow commands and hold a load, a table per arm.

    python benchmarks/servo.py [panda sawyer jaco]
    python benchmarks/servo.py --module examples/own_arm.py own
    python benchmarks/servo.py --computed

Every number is the worst over both directions of a full command to one joint, from
rest at home in free motion, the other joints holding. "first" and "second" are the
shares of the asked change that the joint turned in the first and second control step,
"peak" the greatest speed over the joint's limit while it starts, goes on and reverses,
"torque" the time to full speed at the torque limit. "random" is the share of physics
steps in which a joint is above 1.1 times its limit while all joints are commanded at
random. The sag is that of the tcp in a control step with the rated payload, at poses
where no joint needs more than 70 % of its torque, once the arm has taken the load.

With `--computed`, rotors and gains are those that an arm gets whose value gives none.
"""

import argparse
from dataclasses import replace

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from collaborative_gym import load_module
from collaborative_gym.control import JointChanges
from collaborative_gym.robots import Robot, get_robot, list_robots
from collaborative_gym.scene import Placement, Scene
from collaborative_gym.sim.cpu import CpuSim
from collaborative_gym.timing import CONTROL_DT, SUBSTEPS

AGENT = "robot_1"


class Bench:
    """One arm high above the floor, in several worlds."""

    def __init__(self, robot: Robot, num_envs: int, payload: float = 0.0):
        scene = Scene()
        scene.add_robot(AGENT, robot, placement=Placement((0.0, 0.0, 3.0)))
        if payload:
            load = mujoco.MjSpec()
            body = load.worldbody.add_body()
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[0.03, 0, 0],
                mass=payload,
                contype=0,
                conaffinity=0,
            )
            scene.add_tool(AGENT, "load", child=load)
        JointChanges.add_drives(scene)
        self.model = scene.compile()
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.arm = scene.arms[AGENT]
        self.sim = CpuSim(self.model, num_envs, num_threads=1)
        self.mode = JointChanges(scene, self.sim, gripping=False)

    def start(self, angles: np.ndarray) -> None:
        """Put the worlds at rest at these joint angles, (num_envs, joints)."""
        self.sim.reset()
        self.sim.qpos[:, self.arm.qpos] = angles
        self.mode.start(np.arange(self.sim.num_envs))
        self.sim.forward()

    def step(self, actions: np.ndarray) -> np.ndarray:
        """Do one control step; return speeds, (num_envs, substeps, joints)."""
        controls = self.mode.prepare(self.mode.commands({AGENT: actions}))
        speeds = np.empty((len(actions), SUBSTEPS, actions.shape[1]))
        for i in range(SUBSTEPS):
            self.sim.step(np.ascontiguousarray(controls[:, i : i + 1]))
            speeds[:, i] = self.sim.qvel[:, self.arm.dof]
        return speeds


def follow(robot: Robot) -> dict[str, np.ndarray]:
    """Return what full commands to single joints do, (joints,) by measure."""
    count = len(robot.joints)
    bench = Bench(robot, 2 * count)
    bench.start(np.tile(robot.home, (2 * count, 1)))
    commands = np.concatenate([np.eye(count), -np.eye(count)])
    own = np.tile(np.arange(count), 2)
    rows = np.arange(2 * count)
    scale, limit = bench.arm.stride, np.array(robot.velocity_limits)
    turned, peak = [], np.zeros(2 * count)
    for sign in (1, 1, -1):
        before = bench.sim.qpos[:, bench.arm.qpos].copy()
        speeds = np.abs(bench.step(sign * commands)) / limit
        peak = np.maximum(peak, speeds.max(axis=1)[rows, own])
        moved = (bench.sim.qpos[:, bench.arm.qpos] - before)[rows, own]
        turned.append(np.abs(moved) / scale[own])
    worst = {"first": np.min, "second": np.min}
    shares = {
        key: fold(turned[i].reshape(2, count), axis=0)
        for i, (key, fold) in enumerate(worst.items())
    }
    return {**shares, "peak": peak.reshape(2, count).max(axis=0)}


def inertia_time(robot: Robot) -> np.ndarray:
    """Return the time in s that each joint alone needs to full speed at its limit."""
    bench = Bench(robot, 1)
    bench.start(np.array([robot.home]))
    data = bench.sim.data(0)
    full = np.zeros((bench.model.nv, bench.model.nv))
    mujoco.mj_fullM(bench.model, data, full)
    speed = bench.arm.stride / CONTROL_DT
    return np.diag(full)[bench.arm.dof] * speed / np.array(robot.torque_limits)


def overspeed(robot: Robot, steps: int = 100, worlds: int = 16) -> np.ndarray:
    """Return how much of the time each joint is above 1.1 times its speed limit."""
    bench = Bench(robot, worlds)
    bench.start(np.tile(robot.home, (worlds, 1)))
    rng = np.random.default_rng(0)
    over = [
        np.abs(bench.step(rng.uniform(-1, 1, (worlds, len(robot.joints)))))
        > 1.1 * np.array(robot.velocity_limits)
        for _ in range(steps)
    ]
    return np.mean(over, axis=(0, 1, 2))


def sag(robot: Robot, worlds: int = 100, steps: int = 20) -> np.ndarray:
    """Return the sink of a held payload per control step in mm, one row a world."""
    bench = Bench(robot, worlds, robot.payload)
    bench.start(_loadable_poses(bench, worlds))
    idle = np.zeros((worlds, len(robot.joints)))
    for _ in range(5):
        bench.step(idle)
    before = bench.sim.pose(f"{AGENT}/tcp")[0][:, 2].copy()
    for _ in range(steps):
        bench.step(idle)
    return 1e3 * (before - bench.sim.pose(f"{AGENT}/tcp")[0][:, 2]) / steps


def _loadable_poses(bench: Bench, count: int) -> np.ndarray:
    """Return random poses at which the load takes at most 70 % of any torque limit."""
    robot, arm = bench.arm.robot, bench.arm
    rng = np.random.default_rng(1)
    data = mujoco.MjData(bench.model)
    jacobian = np.zeros((3, bench.model.nv))
    poses = []
    while len(poses) < count:
        data.qpos[arm.qpos] = rng.uniform(*arm.joint_range)
        mujoco.mj_kinematics(bench.model, data)
        mujoco.mj_comPos(bench.model, data)
        shoulder = data.xanchor[arm.dof][1]
        reach = np.linalg.norm(data.site_xpos[arm.tcp] - shoulder) / robot.reach
        mujoco.mj_jacSite(bench.model, data, jacobian, None, arm.tcp)
        torque = np.abs(jacobian[2, arm.dof]) * robot.payload * 9.81
        if 0.3 < reach < 0.9 and np.all(torque < 0.7 * np.array(robot.torque_limits)):
            poses.append(data.qpos[arm.qpos].copy())
    return np.array(poses)


def main() -> None:
    """Print a table for each arm named on the command line, or for all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="arms; none means all")
    parser.add_argument("--module", help="a file that registers arms of your own")
    parser.add_argument("--computed", action="store_true", help="leave out their gains")
    options = parser.parse_args()
    if options.module:
        load_module(options.module)
    for name in options.names or list_robots():
        robot = get_robot(name)
        if options.computed:
            robot = replace(robot, armature=(), damping=(), stiffness=())
        show(robot, Console(width=100))


def show(robot: Robot, console: Console) -> None:
    """Measure an arm and print its table."""
    followed = follow(robot)
    rows = {
        "first, %": 100 * followed["first"],
        "second, %": 100 * followed["second"],
        "peak, of limit": followed["peak"],
        "torque, ms": 1e3 * inertia_time(robot),
        "random, %": 100 * overspeed(robot),
        "damping, N m s/rad": np.array(robot.damping),
        "rotor, kg m2": np.array(robot.armature),
    }
    table = Table(title=robot.title)
    table.add_column("joint")
    for i in range(len(robot.joints)):
        table.add_column(str(i + 1), justify="right")
    for label, values in rows.items():
        digits = 2 if "limit" in label or "rotor" in label else 1
        table.add_row(label, *(f"{value:.{digits}f}" for value in values))
    console.print(table)
    sink = sag(robot)
    console.print(f"sag: {np.median(sink):.2f} mm median, {sink.max():.2f} mm most\n")


if __name__ == "__main__":
    main()
