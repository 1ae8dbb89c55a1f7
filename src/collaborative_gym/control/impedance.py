"""A mode whose actions move the tool as if springs held it to its target."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from collaborative_gym.control import modes
from collaborative_gym.control.drives import Gains, Servo
from collaborative_gym.control.tcp import TcpChanges
from collaborative_gym.math import Array
from collaborative_gym.scene import Scene
from collaborative_gym.sim.sim import Sim

_STIFFNESS = np.array([1000.0] * 3 + [50.0] * 3)
"""Of the tool's springs, in N/m along and N m/rad about each axis. Our choice, within
what real arms offer: Franka's controller takes up to 3000 and 300."""


class _Springs(Servo):
    """Servos whose targets stay where they are when something pushes the arm."""

    def speed(self, sim: Sim) -> Array:
        # The last control is the target's own speed.
        return sim.ctrl[:, self._arm.servos]

    def turn_against(self, torque: Array) -> Array:
        return torque / self.gains[0]


class Impedance(TcpChanges):
    """A change of the pose, as in `tcp`, of a tool held by springs.

    In the operational space (Khatib, "A unified approach for motion and force control
    of robot manipulators", 1987), a stiffness K between the tool and its target acts on
    the joints as the stiffness J^T K J. Each servo takes its stiffness from the
    diagonal of this matrix in the posture at the beginning of a control step, and is
    critically damped for its joint's inertia. The springs are thus in the drives, and
    the physics integrates them implicitly, within the motors' limits. Ignoring
    off-diagonal terms makes the tool stiffer along the arm than across.
    """

    servo = _Springs

    def __init__(self, scene: Scene, sim: Sim, gripping: bool):
        super().__init__(scene, sim, gripping)
        self._springs = sim.xp.asarray(_STIFFNESS[:, None, None, None])
        self._inertias = sim.xp.asarray(_inertias(scene, sim.model))
        self._numbers = sim.expand("actuator_gainprm"), sim.expand("actuator_biasprm")

    def torques(self, sim: Sim, agent: str) -> Array:
        # The task asks of any worlds, so nothing is kept.
        return self._servos[agent].torques(sim, self._gains(sim)[agent])

    def moves(self, motions: Mapping[str, modes.Motion]) -> modes.Encoded:
        self._soften()
        return super().moves(motions)

    def drive(self, controls: Array, commands: Mapping[str, modes.Command]) -> None:
        self._soften()
        gain, bias = self._numbers
        for agent, arm in self.arms.items():
            stiffness, damping = self._servos[agent].gains
            gain[:, arm.servos, 0] = stiffness
            bias[:, arm.servos, 1] = -stiffness
            bias[:, arm.servos, 2] = -damping
        super().drive(controls, commands)

    def _soften(self) -> None:
        for agent, gains in self._gains(self._sim).items():
            self._servos[agent].gains = gains

    def _gains(self, sim: Sim) -> dict[str, Gains]:
        gains: dict[str, Gains] = {}
        xp, jacobian = sim.xp, self._kinematics(self._angles(sim))[1]
        stiffness = xp.sum(self._springs * jacobian * jacobian, axis=0)
        for i, (agent, arm) in enumerate(self.arms.items()):
            own = xp.permute_dims(stiffness[: arm.num_joints, i], (1, 0))
            own = own * self._factor(sim, i)
            damping = 2.0 * (own * self._inertias[arm.dof]) ** 0.5
            gains[agent] = own, damping
        return gains

    def _factor(self, sim: Sim, arm: int) -> Array | float:
        """Return by what the stiffness of an arm's springs is multiplied."""
        return 1.0


@dataclass(frozen=True)
class _Stiffened(modes.Command):
    stiffness: Array


class ImpedanceStiffness(Impedance):
    """As `impedance`, with one more number for the stiffness of the springs.

    At -1 the stiffness is a fourth of the usual one, at 1 four times as much.
    """

    def __init__(self, scene: Scene, sim: Sim, gripping: bool):
        # From there on, `userdata` has the number.
        self._first = sim.model.nuserdata - len(scene.arms)
        super().__init__(scene, sim, gripping)

    @classmethod
    def add_drives(cls, scene: Scene) -> None:
        super().add_drives(scene)
        scene.spec.nuserdata += len(scene.robots)

    def num_moves(self, agent: str) -> int:
        return super().num_moves(agent) + 1

    def commands(self, actions: Mapping[str, Array]) -> modes.Commands:
        shares = {agent: self.split(own)[0][:, -1] for agent, own in actions.items()}
        commands = super().commands(actions).items()
        return {a: _Stiffened(own.moves, own.grips, shares[a]) for a, own in commands}

    def moves(self, motions: Mapping[str, modes.Motion]) -> modes.Encoded:
        moves, most = super().moves(motions)
        return {a: np.pad(rows, ((0, 0), (0, 1))) for a, rows in moves.items()}, most

    def drive(self, controls: Array, commands: Mapping[str, modes.Command]) -> None:
        for i, command in enumerate(commands.values()):
            assert isinstance(command, _Stiffened)
            self._sim.userdata[:, self._first + i] = command.stiffness
        super().drive(controls, commands)

    def _factor(self, sim: Sim, arm: int) -> Array | float:
        return 4.0 ** sim.userdata[:, self._first + arm, None]


def _inertias(scene: Scene, model: mujoco.MjModel) -> np.ndarray:
    """Return each joint's inertia in the arms' postures, (nv,), in kg m2."""
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    for agent, arm in scene.arms.items():
        data.qpos[arm.qpos] = scene.postures[agent]
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    return np.diag(full)


modes.register_mode("impedance", Impedance)
modes.register_mode("impedance_stiffness", ImpedanceStiffness)
