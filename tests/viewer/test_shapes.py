import mujoco
import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")

from collaborative_gym import math
from collaborative_gym.objects.ball import ball
from collaborative_gym.scene import Scene
from collaborative_gym.viewer.shapes import surfaces

KIND = mujoco.mjtGeom
RED = (200, 50, 25)
VIEWS = ((0, 0), (90, 0), (180, 0), (45, 45), (90, -90), (90, 90))
TETRAHEDRON = [0, 0, 0, 0.3, 0, 0, 0, 0.2, 0, 0, 0, 0.1]


@pytest.fixture
def draw():
    """Return a function: the surfaces of a world with one geom, and its model."""

    def draw(**geom):
        spec = mujoco.MjSpec()
        spec.add_mesh(name="wedge", uservert=TETRAHEDRON)
        material = spec.add_material(name="paint", rgba=(0.0, 0.0, 1.0, 1.0))
        assert material is not None
        spec.worldbody.add_geom(**geom)
        model = spec.compile()
        return model, surfaces(model, 0)

    return draw


@pytest.mark.parametrize(
    "geom",
    [
        {"type": KIND.mjGEOM_BOX, "size": [0.1, 0.2, 0.3]},
        {"type": KIND.mjGEOM_CYLINDER, "size": [0.1, 0.2, 0.0]},
        {"type": KIND.mjGEOM_CAPSULE, "size": [0.1, 0.2, 0.0]},
        {"type": KIND.mjGEOM_SPHERE, "size": [0.1, 0.0, 0.0]},
        {"type": KIND.mjGEOM_ELLIPSOID, "size": [0.1, 0.2, 0.3]},
        {"type": KIND.mjGEOM_MESH, "meshname": "wedge"},
    ],
    ids=lambda geom: geom["type"].name,
)
def test_a_shape_fills_mujocos_own_bounds(draw, geom):
    rgba = (*np.array(RED) / 255, 1.0)
    place, turn = (1.0, 2.0, 3.0), (0.5, 0.5, -0.5, 0.5)
    model, [surface] = draw(**geom, rgba=rgba, pos=place, quat=turn)
    away = surface.vertices - model.geom_pos[0]
    triangles = math.rotate(math.conjugate(model.geom_quat[0]), away)[surface.faces]
    centre, half = model.geom_aabb[0][:3], model.geom_aabb[0][3:]
    corners = triangles.reshape(-1, 3)
    np.testing.assert_allclose(corners.min(axis=0), centre - half, atol=2e-3)
    np.testing.assert_allclose(corners.max(axis=0), centre + half, atol=2e-3)
    assert (surface.color, surface.opacity) == (RED, 1.0)
    normals = np.cross(
        triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    )
    outwards = triangles.mean(axis=1) - corners.mean(axis=0)
    assert (np.einsum("ij,ij->i", normals, outwards) > 0).all()  # Seen from outside.


@pytest.mark.parametrize("kind", [KIND.mjGEOM_BOX, KIND.mjGEOM_CYLINDER])
def test_the_light_breaks_at_edges(kind):
    # The page makes light smooth where triangles share a corner.
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=kind, size=[0.1, 0.2, 0.3])
    [surface] = surfaces(spec.compile(), 0)
    faces = surface.faces
    triangles = surface.vertices[faces]
    sides = triangles[:, 1:] - triangles[:, :1]
    is_end = np.abs(np.cross(sides[:, 0], sides[:, 1])[:, 2]) > 1e-9
    assert is_end.any() and not is_end.all()
    assert not set(faces[is_end].ravel()) & set(faces[~is_end].ravel())


def test_a_marker_is_seen_through(draw):
    _, [marker] = draw(type=KIND.mjGEOM_SPHERE, size=[1, 0, 0], rgba=(0, 1, 0, 0.3))
    assert marker.opacity == pytest.approx(0.3)


def test_what_looks_alike_is_one_surface():
    spec, body = mujoco.MjSpec(), None
    body = spec.worldbody.add_body()
    for x, color in ((0.0, RED), (1.0, RED), (2.0, (0, 0, 255))):
        rgba = (*np.array(color) / 255, 1.0)
        body.add_geom(type=KIND.mjGEOM_BOX, size=[0.1] * 3, pos=(x, 0, 0), rgba=rgba)
    spec.worldbody.add_geom(type=KIND.mjGEOM_PLANE, size=[1, 1, 1])
    model = spec.compile()
    assert [floor.is_floor for floor in surfaces(model, 0)] == [True]
    red, blue = surfaces(model, 1)
    assert (red.color, blue.color) == (RED, (0, 0, 255))
    assert (len(red.faces), len(blue.faces)) == (24, 12)
    places = red.vertices[red.faces].mean(axis=1)[:, 0].round()
    assert places.tolist() == [0.0] * 12 + [1.0] * 12


def test_a_material_colours_what_has_no_colour_of_its_own(draw):
    size, paint = [1, 1, 1], {"type": KIND.mjGEOM_BOX, "material": "paint"}
    _, [box] = draw(size=size, **paint)
    assert box.color == (0, 0, 255)
    _, [box] = draw(size=size, rgba=(1, 0, 0, 1), **paint)
    assert box.color == (255, 0, 0)


@pytest.mark.parametrize("unseen", [{"group": 3}, {"rgba": (1, 1, 1, 0)}])
def test_what_off_screen_pictures_do_not_show_is_not_drawn(draw, unseen):
    assert draw(type=KIND.mjGEOM_BOX, size=[1, 1, 1], **unseen)[1] == []


def test_a_shape_that_cannot_be_drawn_is_named():
    spec = mujoco.MjSpec()
    spec.add_hfield(
        name="hill", nrow=2, ncol=2, size=[1, 1, 1, 1], userdata=[0.0, 0.1, 0.2, 0.3]
    )
    spec.worldbody.add_geom(name="ground", type=KIND.mjGEOM_HFIELD, hfieldname="hill")
    with pytest.raises(ValueError, match="geom 'ground' is a HFIELD, which the page"):
        surfaces(spec.compile(), 0)


@pytest.mark.parametrize(
    ("name", "azimuth", "elevation"),
    [("floor", 90, -90), *[("ball", *view) for view in VIEWS]],
)
def test_a_texture_is_where_mujoco_has_it(name, azimuth, elevation):
    spec = Scene().spec if name == "floor" else ball()
    spec.visual.global_.fovy = 8.0 if name == "floor" else 0.1  # m, a side
    model = spec.compile()
    found = surfaces(model, 0 if name == "floor" else 1)
    assert len(found) == 2
    one, other = (each.vertices[each.faces] for each in found)
    points = np.concatenate([one, other]).mean(axis=1)
    is_one = np.arange(len(points)) < len(one)
    blue, is_seen = look(model, points, azimuth, elevation)
    # The bluer of the two colours is cream, or the light squares.
    if found[0].color[2] < found[1].color[2]:
        is_one = ~is_one
    limit = np.median(blue[is_seen & is_one]) + np.median(blue[is_seen & ~is_one])
    agree = (blue > limit / 2) == is_one
    assert is_seen.sum() > 50
    assert agree[is_seen].mean() > 0.93


def look(model, points, azimuth, elevation):
    """Return the picture's blue at the points, and which of them it shows well."""
    data, camera, side = mujoco.MjData(model), mujoco.MjvCamera(), 200
    mujoco.mj_forward(model, data)
    camera.orthographic = 1
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, 3.0
    with mujoco.Renderer(model, side, side) as renderer:
        renderer.update_scene(data, camera)
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        picture = renderer.render()[..., 2].astype(float)
        eye = renderer.scene.camera[0]
    forward, up = np.array(eye.forward), np.array(eye.up)
    right = np.cross(forward, up)
    scale = side / model.vis.global_.fovy
    column = side / 2 + scale * points @ right
    row = side / 2 - scale * points @ up
    is_seen = (np.abs(column - side / 2) < 0.45 * side) & (
        np.abs(row - side / 2) < 0.45 * side
    )
    if np.ptp(points[:, 2]) > 0:  # Of a ball, what faces the camera.
        facing = -points @ forward / np.linalg.norm(points, axis=1)
        is_seen &= facing > 0.6
    inside = np.clip([row, column], 0, side - 1).astype(int)
    return picture[tuple(inside)], is_seen
