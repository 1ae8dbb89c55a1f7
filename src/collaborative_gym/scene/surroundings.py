"""Floor, wall and light of every world."""

import mujoco
import numpy as np

CAMERA = "overview"
"""The camera that every task adds, from which its pictures are taken."""

LARGEST = 1920, 1080
"""Largest width and height of an off-screen picture, in pixels."""

_WALL = (0.80, 0.84, 0.88)


def add_surroundings(spec: mujoco.MjSpec) -> None:
    """Add floor, sky, lights and the quality of off-screen pictures."""
    # A plain room, on whose floor white arms stand out as well as black ones.
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.55, 0.66, 0.78],
        rgb2=_WALL,
        width=512,
        height=512,
    )
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        # Squares that differ more, or are smaller, flicker where they are far away.
        rgb1=[0.53, 0.50, 0.455],
        rgb2=[0.505, 0.475, 0.43],
        width=256,
        height=256,
    )
    floor = spec.add_material(
        name="floor", texrepeat=[0.5, 0.5], texuniform=True, specular=0.0, shininess=0.0
    )
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material="floor",
    )
    _add_lights(spec)
    _set_visuals(spec.visual)


def _add_lights(spec: mujoco.MjSpec) -> None:
    # A lamp above the camera throws the shadows; weaker ones fill them.
    for position, direction, diffuse, tint in (
        ((2.5, -2.0, 4.0), (-0.5, 0.4, -0.8), 0.7, (1.0, 0.95, 0.87)),
        ((2.0, 3.0, 4.0), (-0.4, -0.6, -0.8), 0.2, (0.8, 0.9, 1.0)),
        ((-3.0, 0.0, 3.0), (0.7, 0.0, -0.7), 0.2, (0.8, 0.9, 1.0)),
    ):
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=position,
            dir=direction,
            diffuse=diffuse * np.array(tint),
            specular=[0.25] * 3,
            castshadow=diffuse > 0.4,
        )


def _set_visuals(visual: mujoco.MjVisual) -> None:
    # Haze hides where the floor ends.
    visual.rgba.haze = [*_WALL, 1.0]
    light = visual.headlight
    light.ambient, light.diffuse = [0.28, 0.29, 0.31], [0.15] * 3
    light.specular = [0.05] * 3
    visual.global_.offwidth, visual.global_.offheight = LARGEST
    # A picture off-screen is the mean of several.
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 0
    visual.quality.numslices, visual.quality.numstacks = 20, 10
    visual.quality.numquads = 2
    # A floor that reaches beyond the shadow map is speckled there.
    visual.map.shadowclip, visual.map.znear = 2.0, 0.02


def add_overview(spec: mujoco.MjSpec) -> None:
    """Add the camera of worlds that have none: in front, and above the tables."""
    spec.worldbody.add_camera(
        name=CAMERA, pos=(3.1, 0.0, 1.9), xyaxes=(0, 1, 0, -0.35, 0, 1)
    )
