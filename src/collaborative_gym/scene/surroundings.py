"""What every world has around its arms and objects."""

import mujoco

CAMERA = "overview"
"""The camera that every task adds, from which its pictures are taken."""

LARGEST = 1920, 1080
"""Largest width and height of an off-screen picture, in pixels."""


def add_surroundings(spec: mujoco.MjSpec) -> None:
    """Add floor, sky, lights and the quality of off-screen pictures."""
    _add_floor_and_sky(spec)
    _add_lights(spec)
    _set_quality(spec)


def _add_floor_and_sky(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.82, 0.90, 0.97],
        rgb2=[0.97, 0.98, 1.0],
        width=256,
        height=256,
    )
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.62, 0.61, 0.59],
        rgb2=[0.57, 0.56, 0.54],
        width=256,
        height=256,
    )
    floor = spec.add_material(name="floor", texrepeat=[1, 1], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material="floor",
    )


def _add_lights(spec: mujoco.MjSpec) -> None:
    for position, direction, diffuse in (
        ((2.5, -2.0, 4.0), (-0.5, 0.4, -0.8), 0.55),
        ((2.0, 3.0, 4.0), (-0.4, -0.6, -0.8), 0.3),
    ):
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=position,
            dir=direction,
            diffuse=[diffuse] * 3,
            specular=[0.2] * 3,
            castshadow=diffuse > 0.5,
        )
    headlight = spec.visual.headlight
    headlight.ambient = [0.35] * 3
    headlight.diffuse = [0.25] * 3
    headlight.specular = [0.1] * 3


def _set_quality(spec: mujoco.MjSpec) -> None:
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = LARGEST
    # These are half of MuJoCo's facets and shadow texels. Nobody sees the difference,
    # and without a graphics card a picture takes half the time.
    visual.quality.shadowsize = 2048
    visual.quality.numslices, visual.quality.numstacks = 16, 8
    visual.quality.numquads = 2
    # A floor that reaches beyond the shadow map is speckled there.
    visual.map.shadowclip = 1.5
    visual.map.znear = 0.02


def add_overview(spec: mujoco.MjSpec) -> None:
    """Add the camera of worlds that have none: in front, and above the tables."""
    spec.worldbody.add_camera(
        name=CAMERA, pos=(3.1, 0.0, 1.9), xyaxes=(0, 1, 0, -0.35, 0, 1)
    )
