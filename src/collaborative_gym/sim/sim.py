"""The contract of physics backends with environments and tasks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco

from collaborative_gym.math import Array

EnvIds = Any
"""Sorted integer ids of worlds, a boolean mask over them, or None for all."""

Breaks = Callable[[Array, Array], Array]
"""A function that takes the `sensordata` (..., nsensordata) of physics steps, as it was
when they began and with the forces in them, and which equality constraints were active,
(..., neq) booleans. It returns which of these break."""


@dataclass(frozen=True)
class Refinement:
    """How physics steps in which much happens are taken again as many short steps.

    Each function but `stop` returns (...) booleans for arrays (..., size).

    Attributes:
      steps: how many take the place of one.
      fields: the model's numbers in short steps, by MuJoCo's names.
      strays: takes `qpos` and `qvel` after steps; returns which are to be refined.
      too_deep: takes `sensordata` with current contact sensors; returns likewise.
      too_fast: takes `qvel` after short steps; returns where `stop` is needed.
      stop: takes `qpos` before and `qpos` and `qvel` after a short step, (worlds, size)
        each, and may change the latter two.
    """

    steps: int
    fields: Mapping[str, Array]
    strays: Callable[[Array, Array], Array]
    too_deep: Callable[[Array], Array]
    too_fast: Callable[[Array], Array]
    stop: Callable[[Array, Array, Array], None]


@dataclass(frozen=True)
class Refined:
    """Physics steps that were refined, one in each of some worlds."""

    env_ids: Array  # the worlds, sorted integers
    steps: Array  # (worlds,) indices of the physics steps in their call of `step`
    records: dict[str, Array]  # what each found, (worlds, short steps, ...)


class Sim(Protocol):
    """Many worlds of one model, stepped together.

    The array attributes are live: reading them gives the state after the last call,
    writing all but `sensordata` sets that of the next. MuJoCo's names and units are
    kept. Velocities, positions and depths of contacts in `sensordata` are current after
    every call; forces only after `feel`, and while a physics step is checked.

    Attributes:
      model: the compiled world.
      num_envs: how many worlds there are.
      xp: the array API namespace of its arrays, NumPy's or torch's.
      time: (num_envs,) since the episodes' starts, in s.
      qpos: (num_envs, nq) positions.
      qvel: (num_envs, nv) velocities.
      act: (num_envs, na) servo targets.
      ctrl: (num_envs, nu) controls.
      eq_active: (num_envs, neq) switches of the equality constraints, 0 or 1.
      userdata: (num_envs, nuserdata) what the state holds beside the physics.
      mocap_pos: (num_envs, nmocap, 3) places of the targets.
      xfrc_applied: (num_envs, nbody, 6) forces and torques on the bodies.
      sensordata: (num_envs, nsensordata) read-only sensor values.
      memory: what the task remembers of the worlds' episodes, (num_envs, ...) arrays by
        name. They are replaced and not written to, but for the rows of a reset.
      refinement: how physics steps are refined; None if they never are.
      refined: those that the last call of `step` refined.
    """

    model: mujoco.MjModel
    num_envs: int
    xp: Any
    time: Array
    qpos: Array
    qvel: Array
    act: Array
    ctrl: Array
    eq_active: Array
    userdata: Array
    mocap_pos: Array
    xfrc_applied: Array
    sensordata: Array
    memory: dict[str, Array]
    refinement: Refinement | None
    refined: list[Refined]

    def step(
        self,
        controls: Array,
        records: dict[str, Array] | None = None,
        breaks: Breaks | None = None,
        env_ids: EnvIds = None,
    ) -> None:
        """Advance worlds by some physics steps, then make their sensors current.

        If the worlds were made with a `Refinement`, steps are refined that need it.

        Args:
          controls: (num_envs, substeps, nu), what `ctrl` is during each physics step.
          records: arrays to fill by MuJoCo's names, (num_envs, substeps, ...), with
            the state after each physics step, and with all that follows from a state of
            the one before it; of a step that was refined, its first try.
          breaks: judges each physics step. One that would break equality constraints
            is taken with those switched off, which they then are.
          env_ids: the worlds; None for all. The others keep state and sensors.

        Raises:
          SimulationDiverged: if some worlds became unstable; the others went on.
        """

    def forward(self, env_ids: EnvIds = None) -> None:
        """Make the sensors of these worlds current after a write to their state."""

    def feel(self) -> None:
        """Make forces in the sensors those of the present state and controls."""

    def reset(self, env_ids: EnvIds = None) -> None:
        """Put these worlds into the model's initial state, forgetting all history."""

    def get_state(self, env_ids: EnvIds = None) -> Array:
        """Return a copy of all that decides these worlds' future, one row each."""
        ...

    def set_state(self, state: Array, env_ids: EnvIds = None) -> None:
        """Put rows from `get_state` into these worlds and refresh their sensors."""

    def vary(self, env_ids: EnvIds, factors: Mapping[str, Array]) -> None:
        """Multiply numbers of these worlds' models by factors.

        The factors apply to the model's own numbers. No reset ends them.

        Args:
          env_ids: the worlds.
          factors: by MuJoCo's names, such as `body_mass`, as many as the numbers, with
            an axis for these worlds in front.
        """

    def expand(self, name: str) -> Array:
        """Return the worlds' own numbers of a model by MuJoCo's name, live, a row each.

        They are not in the states.
        """
        ...

    def limits(self, servos: Any) -> Array:
        """Return the greatest torques of some servos, in N m, (num_envs or 1, k)."""
        ...

    def seen(self, qpos: Array, sensordata: Array) -> "Sim":
        """Return worlds in this state, to be measured and not stepped.

        What is remembered of them is not remembered of the worlds themselves.

        Args:
          qpos: (num_envs, nq) positions, in place of the worlds' own.
          sensordata: (num_envs, nsensordata) sensor values, likewise.
        """
        ...

    def pose(self, name: str) -> tuple[Array, Array]:
        """Return position (num_envs, 3) and quaternion w x y z (num_envs, 4), copies.

        Raises:
          KeyError: if there is no place of that name; so does `velocity`.
        """
        ...

    def velocity(self, name: str) -> tuple[Array, Array]:
        """Return copies of linear and angular velocity in the world frame.

        Each is (num_envs, 3), in m/s and rad/s.
        """
        ...

    def jacobian(
        self, body: int, point: Array, env_ids: EnvIds = None
    ) -> tuple[Array, Array]:
        """Return Jacobians of world points that move with a body.

        The translational and the rotational one are (worlds, 3, nv) each.

        Args:
          body: id of the body.
          point: (worlds, 3) points in the world frame.
          env_ids: of which worlds.
        """
        ...

    def own_model(self, env_id: int) -> mujoco.MjModel:
        """Return a world's model, its sites where that world has them, to be read."""
        ...

    def data(self, env_id: int) -> mujoco.MjData:
        """Return one world as a fresh, forwarded `MjData`, to draw it or examine it."""
        ...
