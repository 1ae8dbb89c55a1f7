"""Arms drawn with the shapes of another model of them, such as the maker's meshes."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from collaborative_gym import math
from collaborative_gym.errors import told_by_mujoco
from collaborative_gym.robots import Robot

_APART = 0.01  # m between the axes of a joint in two models of one arm
_ASKEW = 0.02  # rad between them
_HIDDEN = 3  # group of geoms that are not drawn
_SEEN = 2  # greatest group of those that are


def dress(spec: mujoco.MjSpec, agent: str, robot: Robot) -> None:
    """Draw an arm of a scene with the shapes of the file that is its `look`.

    The two models are laid over one another, with their bases in one place and all
    joints at zero. What a joint of the file moves is drawn on what the same joint moves
    here. If the file has no fingers, the hand stays as it is. Textures are left out.

    Args:
      spec: of a scene that is only drawn from then on.
      agent: whose arm.
      robot: the arm.

    Raises:
      FileNotFoundError: if there is no such file.
      ValueError: if MuJoCo cannot read it, or it is not a model of this arm; says why.
    """
    path = Path(robot.look or "")
    if not path.is_file():
        raise FileNotFoundError(f"robot {robot.name!r}: there is no look {path}")
    try:
        look = mujoco.MjSpec.from_file(str(path)).compile()
    except ValueError as error:
        told = told_by_mujoco(error)
        raise ValueError(
            f"robot {robot.name!r}: MuJoCo cannot compile its look {path.name}: {told}"
        ) from error
    own, count = robot.spec().compile(), len(robot.joints)
    joints = [[own.joint(name).id for name in robot.joints], _movable(look)[:count]]
    here, there = _at_zero(own), _at_zero(look)
    _check_alike(robot, here, there, joints)
    fingers, others = robot.gripper.joints, _movable(look)[count:]
    if len(fingers) == len(others):
        joints[0] += [own.joint(name).id for name in fingers]
        joints[1] += others
    # Where a file has no fingers, what is behind its last joint is not the whole hand.
    last = 0 if others else joints[0][-1]
    collides = look.geom_contype | look.geom_conaffinity
    # Geoms that are drawn: those that do not collide, if there are any.
    seen = np.flatnonzero((collides == 0) | collides.all()).tolist()
    for mine, theirs in zip([-1, *joints[0]], [-1, *joints[1]], strict=True):
        shapes = [g for g in seen if _mover(look, look.geom_bodyid[g]) == theirs]
        bodies = [b for b in range(1, own.nbody) if _mover(own, b) == mine]
        bodies = bodies[:1] if mine == last else bodies
        for body in bodies if shapes else ():
            for geom in spec.body(f"{agent}/{own.body(body).name}").geoms:
                geom.group = _HIDDEN
        for geom in shapes:
            _put_on(spec, agent, (here, bodies[0]), (there, geom))


def _movable(model: mujoco.MjModel) -> list[int]:
    kinds = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    return [joint for joint in range(model.njnt) if model.jnt_type[joint] in kinds]


def _mover(model: mujoco.MjModel, body: int) -> int:
    """Return which joint moves a body against what its arm stands on; -1 for none."""
    while body and not model.body_jntnum[body]:
        body = model.body_parentid[body]
    return model.body_jntadr[body] + model.body_jntnum[body] - 1 if body else -1


def _at_zero(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


def _check_alike(
    robot: Robot,
    here: mujoco.MjData,
    there: mujoco.MjData,
    joints: Sequence[Sequence[int]],
) -> None:
    """Raise ValueError unless two models' joints have the same axes in these states."""
    file = Path(robot.look or "").name
    if len(joints[1]) < len(joints[0]):
        raise ValueError(
            f"robot {robot.name!r}: its look {file} has {len(joints[1])} joints, and"
            f" the arm {len(joints[0])}; give a model of the same arm"
        )
    for name, mine, theirs in zip(robot.joints, *joints, strict=True):
        way = there.xanchor[theirs] - here.xanchor[mine]
        axes = here.xaxis[mine], there.xaxis[theirs]
        # An anchor may be anywhere on its axis, and an axis point either way.
        apart = float(np.linalg.norm(np.cross(axes[0], way)))
        askew = float(np.linalg.norm(np.cross(*axes)))
        if apart > _APART or askew > _ASKEW:
            raise ValueError(
                f"robot {robot.name!r}: with all joints at zero, the axis of {name!r}"
                f" and of its look's {there.model.joint(theirs).name!r} are"
                f" {apart * 1000:.0f} mm and {np.degrees(askew):.0f} degrees apart;"
                " give a model of the same arm with its base in the same place"
            )


def _put_on(
    spec: mujoco.MjSpec,
    agent: str,
    wearer: tuple[mujoco.MjData, int],
    worn: tuple[mujoco.MjData, int],
) -> None:
    """Draw a geom of a model on a body of an arm, where it is with joints at zero."""
    (here, body), (there, geom) = wearer, worn
    look, turn = there.model, np.zeros(4)
    mujoco.mju_mat2Quat(turn, there.geom_xmat[geom])
    back = math.conjugate(here.xquat[body])
    material = look.geom_matid[geom]
    kind, form = mujoco.mjtGeom(look.geom_type[geom]), {}
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        form["meshname"] = _copy_mesh(spec, agent, look, look.geom_dataid[geom])
    spec.body(f"{agent}/{here.model.body(body).name}").add_geom(
        type=kind,
        size=look.geom_size[geom],
        pos=math.rotate(back, there.geom_xpos[geom] - here.xpos[body]),
        quat=math.multiply(back, turn),
        rgba=look.mat_rgba[material] if material >= 0 else look.geom_rgba[geom],
        mass=0.0,
        contype=0,
        conaffinity=0,
        group=_SEEN,
        **form,
    )


def _copy_mesh(spec: mujoco.MjSpec, agent: str, look: mujoco.MjModel, mesh: int) -> str:
    """Copy a mesh into a scene, unless it has it; return its name there."""
    name, asset = f"{agent}/look {mesh}", look.mesh(mesh)
    if spec.mesh(name) is None:
        vertices, faces = asset.vertadr[0], asset.faceadr[0]
        corners = look.mesh_vert[vertices : vertices + asset.vertnum[0]]
        triangles = look.mesh_face[faces : faces + asset.facenum[0]]
        spec.add_mesh(
            name=name,
            uservert=corners.flatten(),
            userface=triangles.flatten(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
    return name
