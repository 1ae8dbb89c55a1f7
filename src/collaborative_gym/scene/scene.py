"""Robots and objects put together into one compiled world.

A `Scene` is filled by a task's `build`, gets its drives from an action mode, and is
compiled once. Everything of an arm is under its agent's prefix (`robot_1/joint1`,
`robot_1/tcp`), everything of an object under the object's (`pot/handle_1`). Nothing is
recompiled afterwards: grips are switched and targets moved in the worlds' states.
"""

from collections.abc import Sequence
from functools import reduce
from operator import or_

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from collaborative_gym.errors import (
    check_flag,
    check_kind,
    check_name,
    check_number,
    check_numbers,
    shown,
    told_by_mujoco,
    unknown,
)
from collaborative_gym.math import Array
from collaborative_gym.objects.pedestal import pedestal
from collaborative_gym.objects.table import table
from collaborative_gym.objects.visual import add_wire_path, add_wire_sphere
from collaborative_gym.robots.model_file import finger_bodies, fix_joints
from collaborative_gym.robots.robot import Robot
from collaborative_gym.scene.collisions import exclude_grips, set_collisions, set_stops
from collaborative_gym.scene.contacts import EACH, add_contact_sensor, add_depth_sensors
from collaborative_gym.scene.grasps import get_grasp
from collaborative_gym.scene.handles import Arm, Grip, Placement, find_arm, find_free
from collaborative_gym.scene.hands import Hands
from collaborative_gym.scene.look import dress
from collaborative_gym.scene.surroundings import CAMERA, add_overview, add_surroundings
from collaborative_gym.sim.sim import EnvIds, Sim
from collaborative_gym.timing import SIM_DT

_GREEN, _BRIGHT = (0.0, 0.7, 0.2, 1.0), (0.75, 1.0, 0.35, 1.0)
"""Colours of a goal and of the path on which it moves."""


class Scene:
    """A world under construction, and after `compile` the handles into it.

    Args:
      grasp: how hands hold things, by the name of one of `grasps`.

    Attributes:
      spec: the model under construction.
      robots: the arms that were added, by agent.
      placements: where their bases are.
      grips: the grips that were added.
      tools: names of what was fixed to an arm, by agent.
      solid: whether fingers collide with all but what they can grip, or with nothing.
      arms: after `compile`, each agent's arm in the compiled arrays.
      hands: after `compile`, what holds things in hands; missing without grips.
      postures: after `compile`, by agent, the joint angles in rad that an arm prefers
        when actions fix only its tool's pose; home unless `setup` sets others.
    """

    hands: Hands

    def __init__(self, grasp: str = "magnet") -> None:
        self.grasp = get_grasp(grasp)
        self.spec = mujoco.MjSpec()
        self.spec.compiler.degree = False
        self.robots: dict[str, Robot] = {}
        self.placements: dict[str, Placement] = {}
        self.grips: list[Grip] = []
        self.tools: dict[str, list[str]] = {}
        self.solid = False
        self.arms: dict[str, Arm] = {}
        self.postures: dict[str, np.ndarray] = {}
        self._objects: list[str] = []
        self._targets: list[str] = []
        self._finger_bodies: set[str] = set()
        option = self.spec.option
        option.timestep = SIM_DT
        # It solves contacts and stops together with the servos' damping: so they may be
        # as stiff as the time step resolves.
        option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        # A world that diverges must be reported, not silently put back to its start.
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        add_surroundings(self.spec)

    def add_robot(
        self,
        agent: str,
        robot: Robot,
        *,
        placement: Placement,
        holds: float | None = None,
        stand: bool = True,
    ) -> None:
        """Mount an arm with its stand under the prefix `agent/`.

        What turns its joints comes from the action mode, once the world is complete.

        Args:
          agent: who commands it.
          robot: the arm.
          placement: where its base goes.
          holds: if given, the arm holds a tool of this width (m) for good: its fingers
            are fixed there and have no joints.
          stand: whether to put the arm's own stand under it.
        """
        self._check_free("agent", agent)
        check_kind("robot", robot, Robot, "a Robot, as get_robot returns it")
        check_kind("placement", placement, Placement, "a Placement")
        check_flag("stand", stand)
        if holds is not None:
            check_number("holds", holds, at_least=0.0)
        child = robot.spec()
        gripper = robot.gripper
        if holds is None:
            self._finger_bodies |= {
                f"{agent}/{body.name}" for body in finger_bodies(child, robot.joints)
            }
        else:
            fix_joints(child, dict.fromkeys(gripper.joints, gripper.position(holds)))
        frame = self.spec.worldbody.add_frame(
            pos=placement.position, quat=placement.quat
        )
        self.spec.attach(child, frame=frame, prefix=f"{agent}/")
        self.robots[agent], self.placements[agent] = robot, placement
        if stand:
            self._add_stand(agent, robot, placement)
        for name, armature in zip(robot.joints, robot.armature, strict=True):
            joint = self.spec.joint(f"{agent}/{name}")
            joint.armature = armature
            set_stops(joint)

    def add(
        self,
        name: str,
        child: mujoco.MjSpec,
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        quat: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Put an object into the world under the prefix `name/`.

        Raises:
          TypeError: if an argument is of another kind.
          ValueError: if the name is taken, a place or turn is not valid, or the object
            is in a scene already.
        """
        self._check_free("name", name)
        _check_child(name, child)
        position = check_numbers("position", position, 3)
        quat = check_numbers("quat", quat, 4)
        frame = self.spec.worldbody.add_frame(pos=position, quat=quat)
        self.spec.attach(child, frame=frame, prefix=f"{name}/")
        self._objects.append(name)

    def paint_hand(self, agent: str, rgba: Sequence[float]) -> None:
        """Give an arm's hand a colour, which only pictures show."""
        for geom in self.spec.site(f"{agent}/{self.robots[agent].tcp}").parent.geoms:
            geom.rgba = rgba

    def add_tool(self, agent: str, name: str, *, child: mujoco.MjSpec) -> None:
        """Fix an object to an arm's tcp, as part of the arm, under `agent/name/`."""
        self._check_arm(agent)
        _check_child(name, child)
        tcp = self.spec.site(f"{agent}/{self.robots[agent].tcp}")
        self.spec.attach(child, site=tcp, prefix=f"{agent}/{name}/")
        self.tools.setdefault(agent, []).append(name)

    def add_target(
        self, name: str, radius: float, *, rgba: Sequence[float] = _GREEN
    ) -> None:
        """Add a marker of a goal; `place` moves it and `Sim.pose` reads it.

        Args:
          name: the target's name.
          radius: its rings' radius, in m.
          rgba: their colour.

        Raises:
          ValueError: if the name is taken, or the radius is out of bounds.
        """
        self._check_free("name", name)
        radius = check_number("radius in m", radius, at_least=0.001, at_most=10.0)
        body = self._add_marker(name)
        add_wire_sphere(self.spec, body, radius, rgba)
        body.add_site(name=name)
        self.add_pose_sensor(name, name)

    def add_path(self, name: str, points: np.ndarray) -> None:
        """Add a closed line through points, (n, 3) in m, which `place` moves."""
        self._check_free("name", name)
        add_wire_path(self._add_marker(name), points, _BRIGHT)

    def add_grip(
        self,
        agent: str,
        site: str,
        *,
        threshold: float,
        width: float,
        lever: float | None = None,
    ) -> None:
        """Let an agent grip a site, whose place `Sim.pose(site)` reads.

        A grip can start within `threshold` m, between fingers `width` m apart.

        Raises:
          ValueError: if there is no such arm or site, or the arm's hand cannot hold
            anything by the scene's grasp.
        """
        self._check_arm(agent)
        self._check_site(site)
        self.grasp.strength(self.robots[agent])
        threshold = check_number("threshold in m", threshold, at_least=0.0, at_most=1.0)
        width = check_number("width in m", width, at_least=0.0, at_most=1.0)
        if lever is not None:
            lever = check_number("lever in m", lever, at_least=0.0, at_most=1.0)
        grip = Grip(agent, site, threshold, width, lever)
        self.add_pose_sensor(site, site)
        if not any(agent == other.agent for other in self.grips):
            self._add_palm(grip)
        self.grips.append(grip)
        self.spec.nuserdata = len(self.grips) * (1 + self.grasp.memory)
        self.grasp.add(self.spec, grip, self.robots[agent])

    def add_weld(self, site: str, other: str, *, turns: bool = False) -> None:
        """Hold two sites together in position, and in orientation unless it `turns`."""
        self._check_site(site)
        self._check_site(other)
        self.spec.add_equality(
            name=f"{site} welded to {other}",
            type=mujoco.mjtEq.mjEQ_CONNECT if turns else mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=site,
            name2=other,
            # As stiff as is stable. Arms that work together part it by a millimetre;
            # arms that fight at their torque limits, by one to three centimetres.
            solimp=[0.99, 0.995, 0.001, 0.5, 2.0],
        )

    def add_camera(self, position: ArrayLike, xyaxes: ArrayLike) -> None:
        """Choose from where pictures show the world; the default is a view of all.

        Args:
          position: the camera's position, (3,), in m.
          xyaxes: (6,) directions to the right and upwards in the picture.
        """
        self.spec.worldbody.add_camera(name=CAMERA, pos=position, xyaxes=xyaxes)

    def add_pose_sensor(self, name: str, site: str) -> None:
        """Let `Sim.pose(name)` read a site's position and orientation.

        Tcps, targets and sites that can be gripped have one already, under their names.
        """
        kinds = mujoco.mjtSensor
        self._add_sensor(f"{name}.position", kinds.mjSENS_FRAMEPOS, site)
        self._add_sensor(f"{name}.quat", kinds.mjSENS_FRAMEQUAT, site)

    def add_velocity_sensor(self, name: str, site: str) -> None:
        """Let `Sim.velocity(name)` read a site's linear and angular velocity."""
        kinds = mujoco.mjtSensor
        self._add_sensor(f"{name}.linear", kinds.mjSENS_FRAMELINVEL, site)
        self._add_sensor(f"{name}.angular", kinds.mjSENS_FRAMEANGVEL, site)

    def compile(self) -> mujoco.MjModel:
        """Compile the world and resolve every handle.

        Purely visual shapes are left out, because it would take a fifth of the
        physics' time: MuJoCo keeps the inertia of its bodies.

        Raises:
          ValueError: if MuJoCo cannot compile what was added.
        """
        for agent, robot in self.robots.items():
            self.add_pose_sensor(f"{agent}/tcp", f"{agent}/{robot.tcp}")
        apart = set() if self.grasp.touches else self._finger_bodies
        if self.solid:
            exclude_grips(self.spec, self.grips, apart)
            apart = set()
        set_collisions(self.spec, self.robots, apart)
        add_depth_sensors(self.spec, self.robots)
        if not any(camera.name == CAMERA for camera in self.spec.cameras):
            add_overview(self.spec)
        physics = self.spec.copy()
        physics.compiler.discardvisual = True
        try:
            model = physics.compile()
        except ValueError as error:
            told = told_by_mujoco(error)
            raise ValueError(f"MuJoCo cannot compile the scene: {told}") from error
        self._resolve(model)
        return model

    def compile_to_draw(self) -> mujoco.MjModel:
        """Compile the world with all its geoms; its `qpos` and mocap are the same.

        Raises:
          FileNotFoundError: if the file of an arm's look is missing.
          ValueError: if it is not a model of the arm.
        """
        spec = self.spec.copy()
        for agent, robot in self.robots.items():
            if robot.look is not None:
                dress(spec, agent, robot)
        return spec.compile()

    def place(
        self,
        sim: Sim,
        env_ids: EnvIds,
        *,
        name: str,
        position: Array,
        quat: Array | None = None,
    ) -> None:
        """Put an object that moves freely, or a target, somewhere in these worlds.

        Args:
          sim: the worlds.
          env_ids: which of them.
          name: the object's, as `add` or `add_target` got it.
          position: of its body's origin, (worlds, 3) or (3,), in m.
          quat: (worlds, 4) or (4,), w x y z; None leaves it. Targets have none.

        Raises:
          ValueError: if nothing of that name can be moved, or it cannot be put there.
        """
        names = [*self._mocap, *self._free]
        if name not in names:
            raise ValueError(
                f"{unknown('movable object', name, names)}; only objects with a"
                " free joint, and what `add_target` added, can be placed"
            )
        try:
            if name in self._mocap:
                sim.mocap_pos[env_ids, self._mocap[name]] = sim.xp.asarray(position)
                return
            start = self._free[name]
            sim.qpos[env_ids, start : start + 3] = sim.xp.asarray(position)
            if quat is not None:
                sim.qpos[env_ids, start + 3 : start + 7] = sim.xp.asarray(quat)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"{name!r} cannot be put at position {shown(position)} with quat"
                f" {shown(quat)}; give (3,) and (4,) numbers, or a row for each world"
            ) from error

    def bend(self, sim: Sim, env_ids: EnvIds, *, agent: str, angles: ArrayLike) -> None:
        """Put an arm at joint angles in these worlds, kept within the joints' ranges.

        The angles are (worlds, joints) or (joints,), in rad.
        """
        arm = self.arms[agent]
        angles = np.clip(angles, *arm.joint_range)
        sim.qpos[env_ids, arm.qpos] = sim.xp.asarray(angles)

    def holds(self, sim: Sim, agent: str, *, site: str | None = None) -> Array:
        """Return in which worlds a grip of the agent holds, (num_envs,) booleans.

        Args:
          sim: the worlds.
          agent: whose grip.
          site: what it holds; None for anything.

        Raises:
          ValueError: if the agent has no such grip.
        """
        own = [g.agent == agent and site in (None, g.site) for g in self.grips]
        if not any(own):
            raise ValueError(
                f"{agent} has no {f'grip of {site!r}' if site else 'grip'}; give it one"
                " by add_grip when the world is built"
            )
        held = self.hands.is_held(sim)
        return reduce(or_, (held[:, i] for i in range(len(own)) if own[i]))

    def add_pad_sensors(self) -> None:
        """Add to a scene that is not compiled yet what `Hands.pad_forces` reads."""
        touches = [sensor for sensor in self.spec.sensors if " by " in sensor.name]
        for touch in touches if self.grasp.touches else ():
            places = (touch.objtype, touch.objname), (touch.reftype, touch.refname)
            name = touch.name.replace(" by ", " pressed by ")
            add_contact_sensor(self.spec, name, *places, fields=EACH)

    def targets(self, sim: Sim) -> dict[str, Array]:
        """Return the places of the targets by name, (num_envs, 3) each, in m."""
        return {name: sim.mocap_pos[:, i] for name, i in self._mocap.items()}

    def objects(self, sim: Sim) -> dict[str, Array]:
        """Return the places of what moves freely by name, (num_envs, 3) each, in m."""
        return {name: sim.qpos[:, i : i + 3] for name, i in self._free.items()}

    def _resolve(self, model: mujoco.MjModel) -> None:
        self.arms = {a: find_arm(model, a, robot) for a, robot in self.robots.items()}
        self.postures = {a: np.array(robot.home) for a, robot in self.robots.items()}
        if self.grips:
            self.hands = self.grasp.resolve(self.grips, model, self.arms)
        self._mocap = {name: int(model.body(name).mocapid[0]) for name in self._targets}
        self._free = find_free(model, self._objects)

    def _add_marker(self, name: str) -> mujoco.MjsBody:
        self._targets.append(name)
        return self.spec.worldbody.add_body(name=name, mocap=True)

    def _check_free(self, argument: str, name: str) -> None:
        check_name(argument, name)
        if name in {*self.robots, *self._objects, *self._targets}:
            raise ValueError(f"{argument} {name!r} is taken; give another")

    def _check_arm(self, agent: str) -> None:
        if agent not in self.robots:
            raise ValueError(
                f"{unknown('arm', agent, self.robots)}; add_robot comes first"
            )

    def _check_site(self, site: str) -> None:
        names = [element.name for element in self.spec.sites if element.name]
        if site not in names:
            raise ValueError(
                f"{unknown('site', site, names)}; the name of its object"
                " stands before that of a site, as in 'pot/handle_1'"
            )

    def _add_sensor(self, name: str, kind: mujoco.mjtSensor, site: str) -> None:
        self._check_site(site)
        known = self.spec.sensor(name)
        if known is not None:
            if known.objname != site:
                raise ValueError(
                    f"{name.rpartition('.')[0]!r} is measured at the site"
                    f" {known.objname!r} already; give {site!r} another name"
                )
            return
        self.spec.add_sensor(
            name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site
        )

    def _add_palm(self, grip: Grip) -> None:
        """Add a body to a hand that bears its grips alone, and a sensor of its load.

        It weighs nothing, so what the hand exerts on it is the force of the grips. Its
        frame is the hand's, from where MuJoCo takes the stiffness of a constraint.
        """
        tcp = self.spec.site(f"{grip.agent}/{self.robots[grip.agent].tcp}")
        palm = tcp.parent.add_body(name=grip.palm)
        palm.add_site(name=grip.palm, pos=tcp.pos)
        self._add_sensor(grip.palm, mujoco.mjtSensor.mjSENS_FORCE, grip.palm)

    def _add_stand(self, agent: str, robot: Robot, placement: Placement) -> None:
        x, y, height = placement.position
        if robot.stand != "none":
            at_floor = robot.stand == "pedestal"
            stand = pedestal(height) if at_floor else table(height=height)
            self.add(f"{agent}_stand", stand, position=(x, y, 0), quat=placement.quat)


def _check_child(name: str, child: mujoco.MjSpec) -> None:
    check_kind(f"the child {name!r}", child, mujoco.MjSpec, "an MjSpec")
    if child.parent is not None:
        raise ValueError(
            f"the child given as {name!r} is in a scene already; call the function"
            " that made it once more, and add what it returns"
        )
