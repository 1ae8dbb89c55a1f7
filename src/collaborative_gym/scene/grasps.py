"""A ladder of grasps, from a magnet down to the contacts of fingers alone.

`TaskConfig.grasp` chooses one for all hands of a world:

- `magnet`: pulls an object's site to the tool centre point, and lets it turn there. It
  bears the gripper's `holding_force`, and opens when it is torn.
- `suction`: a cup of 40 mm at the tool centre point, which faces along its z axis. At a
  vacuum of 60 %, it holds with 0.6 x 101,325 Pa x its area, 76 N. It bears what its
  friction cone allows: a force t along the cup and a pull p away from it with
  t <= 0.5 (76 N - p). The formula, and 0.5 for wood, metal and glass, are Schmalz's
  ("Theoretical holding force of a suction cup").
- `pinch`: two pads that each press with the gripper's force F. They bear 2 mu F in any
  direction; mu = 1 is MuJoCo's default and about that of rubber on a dry surface.
- `friction`: contacts alone. Fingers and objects collide. The hand closes with all its
  force and holds what two of its fingers touch. At 10 ms and with an `impratio` of 10,
  an object slips 0.01 mm/s at rest. In motion it creeps at a speed of about 10 ms times
  the acceleration along the pads, whatever the force, so a hand must move gently.

Cup and pads keep an object in the pose in which they took it. Under a load beyond their
bound, it slips: nothing holds it for the rest of the control step. Then they take it
again where it is, if it is still within reach. An object turns in them by at most 3
degrees before it starts to slip. Sizes and compliance of cup and pads are our choice.
"""

from collaborative_gym.errors import look_up
from collaborative_gym.scene.friction import Friction
from collaborative_gym.scene.hands import Grasp, Pinch, Suction

_GRASPS: dict[str, Grasp] = {
    "magnet": Grasp(),
    "suction": Suction(),
    "pinch": Pinch(),
    "friction": Friction(),
}

GRASPS = tuple(_GRASPS)
"""The names of the grasps."""


def get_grasp(name: str) -> Grasp:
    """Return a grasp by name.

    Raises:
      KeyError: if there is none of that name.
    """
    return look_up("grasp", name, _GRASPS)
