r"""A harder Pass to begin with: hands must come nearer before they can grip.

A policy whose hand stops at the very edge of where it can grip fails where it stops a
millimetre earlier. One that learned here has room to spare:

    collaborative-gym train PassNearSawyers-v0 --module examples/nearer_grips.py
    collaborative-gym train PassTaskSawyers-v0 --module examples/nearer_grips.py \
        --start-from runs/PassNearSawyers-v0-collaborative-seed0
"""

import collaborative_gym as cg
from collaborative_gym.scene import Placement
from collaborative_gym.tasks.pass_ import Pass

PLACEMENTS = Placement((0.0, -0.7, 1.0)), Placement((0.0, 0.7, 1.0))
SETTINGS = {
    "placements": PLACEMENTS,  # as in PassTaskSawyers-v0
    "picking_threshold": 0.02,  # m, there 0.03
    "handover_threshold": 0.04,  # m, there 0.05
}
cg.register_env(cg.EnvSpec("PassNearSawyers-v0", Pass, ("sawyer", "sawyer"), SETTINGS))
