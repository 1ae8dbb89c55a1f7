"""A world's geoms as surfaces that a web page can draw."""

from typing import NamedTuple

import mujoco
import numpy as np

from collaborative_gym import math

_MAX_GROUP = 2  # geoms of higher groups collide and are not seen
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # a geom of this colour takes its material's
_FLOOR = 60.0  # half width of the drawn part of an endless plane, in m
_SQUARE = 1.0  # side of the squares in which a plane is coloured, in m

_SECTORS, _FINE = 24, 64
"""Number of sectors of a round shape, and of a ball, whose triangles show a texture."""

_MAX_COLORS = 4  # a texture with more colours than this is drawn in their mean

_CUBE = np.array(
    [
        [[0, 0, -1], [0, -1, 0]],
        [[0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 0, 1]],
        [[1, 0, 0], [0, 0, -1]],
        [[1, 0, 0], [0, -1, 0]],
        [[-1, 0, 0], [0, -1, 0]],
    ]
)
"""Where the columns and rows of a cube texture's faces (x, -x, y, -y, z, -z) go."""

_KIND = mujoco.mjtGeom


class _Mesh(NamedTuple):
    """Corners (n, 3) in m, and their indices in each triangle, seen from outside.

    The light is smooth where triangles share a corner.
    """

    vertices: np.ndarray
    faces: np.ndarray


class Surface(NamedTuple):
    """Geoms of a body that look alike.

    Corners (n, 3) in m in the body's frame, and their indices in each triangle, seen
    from outside; the colour, 0 to 255, the opacity, 0 to 1, and whether it is a floor.
    """

    vertices: np.ndarray
    faces: np.ndarray
    color: tuple[int, int, int]
    opacity: float
    is_floor: bool


def surfaces(model: mujoco.MjModel, body: int) -> list[Surface]:
    """Return the surfaces of a body, in its frame, one for each look.

    Raises:
      ValueError: if geoms of a kind cannot be drawn.
    """
    first, found = model.body_geomadr[body], {}
    for geom in range(first, first + model.body_geomnum[body]):
        rgba = _rgba(model, geom)
        if model.geom_group[geom] > _MAX_GROUP or rgba[3] == 0:
            continue
        mesh, is_floor = _mesh(model, geom), model.geom_type[geom] == _KIND.mjGEOM_PLANE
        painted = _painted(model, geom, mesh, rgba[:3])
        turn, place = model.geom_quat[geom], model.geom_pos[geom]
        vertices = place + math.rotate(turn, mesh.vertices)
        for color, faces in painted:
            color = tuple(np.rint(255 * color).astype(int).tolist())
            looks = color, round(float(rgba[3]), 6), is_floor
            found.setdefault(looks, []).append(_Mesh(vertices, faces))
    return [Surface(*_joined(parts), *looks) for looks, parts in found.items()]


def _joined(meshes: list[_Mesh]) -> _Mesh:
    firsts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + first for mesh, first in zip(meshes, firsts, strict=True)]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return _Mesh(vertices, np.concatenate(faces))


def _rgba(model: mujoco.MjModel, geom: int) -> np.ndarray:
    own, material = model.geom_rgba[geom], model.geom_matid[geom]
    if material >= 0 and np.allclose(own, _DEFAULT_RGBA):
        return model.mat_rgba[material]
    return own


def _mesh(model: mujoco.MjModel, geom: int) -> _Mesh:
    """Return a geom's surface in its own frame, with edges where it is not smooth."""
    size = model.geom_size[geom].astype(float)
    match _KIND(model.geom_type[geom]):
        case _KIND.mjGEOM_BOX:
            return _box(size)
        case _KIND.mjGEOM_CYLINDER:
            rims = [size[:2] * (1, -1)] * 2 + [size[:2]] * 2
            return _turned(np.array([(0, -size[1]), *rims, (0, size[1])]))
        case _KIND.mjGEOM_CAPSULE:
            below, above = _arc(-1, 0), _arc(0, 1)
            ends = np.concatenate([size[0] * below, size[0] * above])
            ends[:, 1] += np.repeat([-size[1], size[1]], len(below))
            return _turned(ends)
        case _KIND.mjGEOM_SPHERE:
            return _turned(size[0] * _arc(-1, 1, _FINE), _FINE)
        case _KIND.mjGEOM_ELLIPSOID:
            ball = _turned(_arc(-1, 1))
            return ball._replace(vertices=size * ball.vertices)
        case _KIND.mjGEOM_PLANE:
            return _plane(*(half or _FLOOR for half in size[:2]))
        case _KIND.mjGEOM_MESH:
            asset = model.mesh(model.geom_dataid[geom])
            first, face = asset.vertadr[0], asset.faceadr[0]
            return _Mesh(
                model.mesh_vert[first : first + asset.vertnum[0]],
                model.mesh_face[face : face + asset.facenum[0]],
            )
    raise ValueError(
        f"geom {model.geom(geom).name!r} is a {_KIND(model.geom_type[geom]).name[7:]},"
        " which the page cannot draw"
    )


def _box(half: np.ndarray) -> _Mesh:
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    sides = [
        np.roll(np.insert(square[::sign], 0, sign, axis=1), axis, axis=1)
        for axis in range(3)
        for sign in (1, -1)
    ]
    faces = 4 * np.arange(6)[:, None, None] + [[0, 1, 2], [0, 2, 3]]
    return _Mesh(half * np.concatenate(sides), faces.reshape(-1, 3))


def _turned(profile: np.ndarray, sectors: int = _SECTORS) -> _Mesh:
    """Return the surface of a line that is turned about z.

    The line has (points, 2) radii and heights from below, in m. Where a point comes
    twice, there is an edge.
    """
    here = np.arange(sectors)
    angles = 2 * np.pi * here / sectors
    radius, height = profile[:, :1], profile[:, 1:]
    rings = radius * np.cos(angles), radius * np.sin(angles), height + 0 * angles
    vertices = np.stack(rings, axis=-1).reshape(-1, 3)
    first = np.arange(len(profile) - 1)[:, None] * sectors
    here, beside = first + here, first + np.roll(here, -1)
    lower = np.stack([here, beside, beside + sectors], axis=-1)
    upper = np.stack([here, beside + sectors, here + sectors], axis=-1)
    faces = np.concatenate([lower, upper]).reshape(-1, 3)
    # At the axis, and between two points at one place, some have no area.
    corners = vertices[faces]
    sides = corners[:, 1:] - corners[:, :1]
    return _Mesh(vertices, faces[np.cross(sides[:, 0], sides[:, 1]).any(axis=1)])


def _arc(first: int, last: int, sectors: int = _SECTORS) -> np.ndarray:
    angles = np.linspace(first, last, (last - first) * sectors // 4 + 1) * np.pi / 2
    # On the axis the radius must be exactly 0.
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1).round(12)


def _plane(x: float, y: float) -> _Mesh:
    """Return squares that cover a plane, x and y being half its widths in m."""
    columns, rows = (max(1, round(2 * half / _SQUARE)) for half in (x, y))
    across, along = np.meshgrid(
        np.linspace(-x, x, columns + 1), np.linspace(-y, y, rows + 1)
    )
    vertices = np.stack([across, along, np.zeros_like(across)], axis=-1).reshape(-1, 3)
    corner = np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)
    corner = corner.reshape(-1, 1)
    above = corner + columns + 1
    triangles = [corner, corner + 1, above + 1, corner, above + 1, above]
    return _Mesh(vertices, np.hstack(triangles).reshape(-1, 3))


def _painted(
    model: mujoco.MjModel, geom: int, mesh: _Mesh, rgb: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the colours of a surface, 0 to 1, and the faces that have each."""
    texels = _texels(model, geom, mesh.vertices[mesh.faces].mean(axis=1))
    if texels is None:
        return [(rgb, mesh.faces)]
    colors, which = np.unique(texels, axis=0, return_inverse=True)
    if len(colors) > _MAX_COLORS:
        return [(rgb * texels.mean(axis=0) / 255, mesh.faces)]
    return [(rgb * own / 255, mesh.faces[which == i]) for i, own in enumerate(colors)]


def _texels(model: mujoco.MjModel, geom: int, points: np.ndarray) -> np.ndarray | None:
    """Return a texture's colours at points of a geom, (points, 3), if it has one."""
    material = model.geom_matid[geom]
    role = mujoco.mjtTextureRole.mjTEXROLE_RGB
    texture = model.mat_texid[material, role] if material >= 0 else -1
    if texture < 0:
        return None
    height, width = model.tex_height[texture], model.tex_width[texture]
    start, channels = model.tex_adr[texture], model.tex_nchannel[texture]
    image = model.tex_data[start : start + height * width * channels]
    if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D:
        # MuJoCo repeats a uniform texture every two metres, and turns it over.
        place = 0.5 * points[:, :2] * model.mat_texrepeat[material] * (1, -1)
        image = image.reshape(1, height, width, channels)
        face = np.zeros(len(points), int)
    else:
        major = np.abs(points).argmax(axis=1)
        depth = points[np.arange(len(points)), major]
        face = 2 * major + (depth < 0)
        place = np.einsum("nij,nj->ni", _CUBE[face], points) / np.abs(depth)[:, None]
        place = 0.5 + 0.5 * place
        image = image.reshape(6, -1, width, channels)
    shape = image.shape[2], image.shape[1]
    column, row = (place % 1 * shape).astype(int).T
    return image[face, row, column, :3]
