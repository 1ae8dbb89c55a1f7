"""A block, a peg and a pin that locks them, of wood, each with a knob to be held by.

Together they have one frame: once they are assembled, the bodies `block`, `peg` and
`pin` have the same pose. The peg goes along -x into the block's square hole, whose edge
is chamfered, until its collar meets the block. The pin, which is round, goes along -y
through a square hole in the block's walls and in the peg. Either has `PLAY` there.
"""

import mujoco
import numpy as np

from collaborative_gym.math import from_rotation_vector, from_yaw, multiply, rotate
from collaborative_gym.objects.visual import begin

PLAY = 0.002
"""By how much holes are wider than what goes into them, in m."""

HALF = 0.03  # m, height of the axes above what parts lie on
# How far block, peg and pin go in, in m, from the mouth of a hole to the end.
DEEP = np.array([0.0, 0.066, 0.058])
ARM = 0.22  # m from the middle to the knobs of peg and pin
KNOB = 0.024  # m, width of a knob
_PEG, _PIN = 0.015, 0.007  # m, half the peg's side, and the pin's radius
_HOLE, _SLOT = _PEG + PLAY / 2, _PIN + PLAY / 2  # m, half the sides of their holes
_CHAMFER, _THICK = 0.008, 0.003  # m, depth of the chamfer, half the thickness of a rim
_MOUTH = HALF + _CHAMFER  # m from the middle to the outer end of the chamfer
_TIP = _MOUTH - DEEP[1]  # m, x of the peg's tip
_COLLAR, _LOW = 0.004, 0.018  # m, half its thickness; its top, below fingers
_KNOB_Z = 0.06  # m from an axis up to the middle of a knob
_DENSITY = 700.0  # kg/m^3, of beech
# Waxed wood slides at 0.2 to 0.3 times what presses.
_FRICTION = 0.25, 0.005, 0.0001
_BLOCK_RGBA = (0.58, 0.36, 0.70, 1.0)
_PEG_RGBA = (0.16, 0.47, 0.82, 1.0)
_PIN_RGBA = (0.90, 0.45, 0.13, 1.0)
_DOWN = np.array([0.0, 0.5**0.5, 0.5**0.5, 0.0])  # a hand that closes along x


class _Part:
    """A part under construction: a free body of boxes of one colour."""

    def __init__(self, name: str, rgba: tuple[float, float, float, float]):
        self.spec, self._body = begin(name)
        self._name, self._rgba, self._count = name, rgba, 0
        self._body.add_joint(type=mujoco.mjtJoint.mjJNT_FREE, name="free")
        self._body.add_site(name=name)

    def add(self, one, other) -> None:
        """Add a box from one corner to the opposite one, in m."""
        size, pos = np.abs(np.subtract(other, one)) / 2, np.add(one, other) / 2
        self.add_turned(size, pos, (1.0, 0.0, 0.0, 0.0))

    def add_turned(self, size, pos, quat, kind=mujoco.mjtGeom.mjGEOM_BOX) -> None:
        """Add a shape."""
        self._count += 1
        self._body.add_geom(
            name=f"{self._name}_{self._count}",
            type=kind,
            size=size,
            pos=pos,
            quat=quat,
            density=_DENSITY,
            rgba=self._rgba,
            friction=_FRICTION,
            priority=1,
            group=2,
        )

    def add_knob(self, x: float, y: float, yaw: float) -> None:
        """Add a knob, and the site `knob`: a hand that holds it, which closes there.

        At a yaw of 0 it closes along x.
        """
        turn, place = from_yaw(np.array(yaw)), (x, y, _KNOB_Z)
        size = (KNOB / 2, 0.02, _KNOB_Z - HALF)
        self.add_turned(size, place, turn)
        self._body.add_site(name="knob", pos=place, quat=multiply(turn, _DOWN))


def block() -> mujoco.MjSpec:
    """Return a block with a hole along x, and a hole for the pin along y.

    The body and site `block` have their origin where the holes cross. Its hole for the
    peg is open at both ends and chamfered at +x.
    """
    part = _Part("block", _BLOCK_RGBA)
    for z in (-1.0, 1.0):
        part.add((-HALF, -HALF, z * _HOLE), (HALF, HALF, z * HALF))
    for y in (-1.0, 1.0):
        for sign in (-1.0, 1.0):
            x, z = sign * _SLOT, sign * _HOLE
            part.add((x, y * _HOLE, -_HOLE), (sign * HALF, y * HALF, _HOLE))
            part.add((-_SLOT, y * _HOLE, sign * _SLOT), (_SLOT, y * HALF, z))
    # Boards that lean outwards, from the edge of the hole.
    size = (_CHAMFER / 2**0.5, _HOLE + _CHAMFER, _THICK)
    middle = np.array([HALF + _CHAMFER / 2, 0.0, _HOLE + _CHAMFER / 2])
    middle += _THICK * np.array([-(0.5**0.5), 0.0, 0.5**0.5])
    lean = from_rotation_vector(np.array([0.0, -np.pi / 4, 0.0]))
    for i in range(4):
        roll = from_rotation_vector(np.array([i * np.pi / 2, 0.0, 0.0]))
        part.add_turned(size, rotate(roll, middle), multiply(roll, lean))
    part.add_knob(0.0, 0.0, -np.pi / 4)
    return part.spec


def peg() -> mujoco.MjSpec:
    """Return a square peg along x, held at `ARM`, with a collar and a hole along y."""
    part = _Part("peg", _PEG_RGBA)
    part.add((_TIP, -_PEG, -_PEG), (-_SLOT, _PEG, _PEG))
    for z in (-1.0, 1.0):
        part.add((-_SLOT, -_PEG, z * _SLOT), (_SLOT, _PEG, z * _PEG))
    part.add((_SLOT, -_PEG, -_PEG), (ARM - 0.025, _PEG, _PEG))
    part.add((_MOUTH, -0.025, -HALF), (_MOUTH + 2 * _COLLAR, 0.025, _LOW))
    part.add((ARM - 0.025, -0.025, -HALF), (ARM + 0.025, 0.025, HALF))
    part.add_knob(ARM, 0.0, np.pi / 2)
    return part.spec


def pin() -> mujoco.MjSpec:
    """Return a round pin along y, held at `ARM`, with a round tip and a collar."""
    part, end = _Part("pin", _PIN_RGBA), HALF - DEEP[2] + _PIN
    turn = np.array([0.5**0.5, 0.5**0.5, 0.0, 0.0])
    size, place = (_PIN, (ARM - end) / 2, 0.0), (0.0, (ARM + end) / 2, 0.0)
    part.add_turned(size, place, turn, mujoco.mjtGeom.mjGEOM_CAPSULE)
    part.add((-0.02, HALF, -HALF), (0.02, HALF + 2 * _COLLAR, _LOW))
    part.add((-0.025, ARM - 0.025, -HALF), (0.025, ARM + 0.025, HALF))
    part.add_knob(0.0, ARM, 0.0)
    return part.spec
