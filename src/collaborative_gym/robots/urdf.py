"""URDF files as they come from makers, read without editing them."""

import re
from collections import Counter
from math import tau
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import mujoco

from collaborative_gym.errors import told_by_mujoco, unknown

_MESHES = {".stl", ".obj", ".msh"}  # formats that MuJoCo reads


def read_urdf(path: Path) -> mujoco.MjSpec:
    """Return the model of a URDF file.

    MuJoCo alone would drop the visual shapes, look for meshes of a ROS package in a
    folder "package:", and leave continuous joints without a range. Here such joints get
    one turn either way. A `mujoco` element of the file still holds.

    Raises:
      FileNotFoundError: if a mesh is missing.
      ValueError: if MuJoCo cannot read the file as URDF.
    """
    root = _parse(path)
    _check_tree(root)
    compiler = _child(_child(root, "mujoco"), "compiler")
    compiler.attrib.setdefault("discardvisual", "false")
    for joint in root.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = _child(joint, "limit")
            limit.attrib.setdefault("lower", str(-tau))
            limit.attrib.setdefault("upper", str(tau))
    if not {"meshdir", "assetdir", "strippath"} & set(compiler.attrib):
        for link in root.iter("link"):
            _find_meshes(link, path)
    spec = _read_by_mujoco(root)
    spec.modelfiledir = str(path.parent)
    for body in spec.bodies:
        if any(_is_seen_only(geom) for geom in body.geoms):
            for geom in body.geoms:
                geom.group = 2 if _is_seen_only(geom) else 3
    return spec


def _parse(path: Path) -> ElementTree.Element:
    # Prefixes such as `drake:` stay parts of names, declared or not, as for MuJoCo.
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise ValueError(f"it is not XML: {error}") from error
    root = builder.close()
    if root.tag != "robot":
        raise ValueError(f"a URDF file begins with <robot>, this one with <{root.tag}>")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise ValueError(
            f"it is a xacro file; expand it first: xacro {path.name} > arm.urdf"
        )
    return root


def _check_tree(root: ElementTree.Element) -> None:
    """Raise ValueError if two parts share a name, or a joint names what is not there.

    MuJoCo refuses this too, but does not say which name it means.
    """
    names = {
        kind: [element.get("name", "") for element in root.findall(kind)]
        for kind in ("link", "joint")
    }
    for kind, given in names.items():
        name, count = Counter(given).most_common(1)[0] if given else ("", 0)
        if count > 1:
            raise ValueError(
                f"it has {count} {kind}s {name!r}; give each of them a name of its own"
            )
    for joint in root.findall("joint"):
        for role, kind in (("parent", "link"), ("child", "link"), ("mimic", "joint")):
            other = joint.find(role)
            if other is not None and other.get(kind) not in names[kind]:
                wrong = unknown(kind, other.get(kind), names[kind])
                raise ValueError(f"{role} of joint {joint.get('name')!r}: {wrong}")


def _read_by_mujoco(root: ElementTree.Element) -> mujoco.MjSpec:
    """Return a URDF file as MuJoCo reads it; an error names the link or joint."""
    # Each link and joint is on a line of its own, so MuJoCo's line tells which it is.
    root.text = "\n"
    for part in root:
        for element in part.iter():
            element.text = element.tail = None
        part.tail = "\n"
    try:
        return mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    except ValueError as error:
        told, line = told_by_mujoco(error), re.search(r", line (\d+)", str(error))
        if line is None:
            raise ValueError(told) from error
        part = root[int(line[1]) - 2]
        told = told.replace(line[0], "")
        raise ValueError(f"{part.tag} {part.get('name')!r}: {told}") from error


def _child(element: ElementTree.Element, name: str) -> ElementTree.Element:
    found = element.find(name)
    return ElementTree.SubElement(element, name) if found is None else found


def _find_meshes(link: ElementTree.Element, path: Path) -> None:
    """Let a link's meshes name their files in full."""
    for kind in ("visual", "collision"):
        for element in link.findall(kind):
            mesh = element.find("geometry/mesh")
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            if Path(name).suffix.lower() in _MESHES:
                mesh.set("filename", str(_find(name, path)))
            elif kind == "visual":
                # The link's collision shapes are drawn in its place.
                link.remove(element)
            else:
                raise ValueError(
                    f"MuJoCo cannot read the collision mesh {name}; convert it to STL"
                    " or OBJ"
                )


def _find(name: str, path: Path) -> Path:
    """Return where the file of a mesh is.

    A package is searched beside all folders above the URDF file, because the file is in
    the folder of its package, or of another package beside it.
    """
    if name.startswith("package://"):
        rest = name.removeprefix("package://")
        tried = [folder / rest for folder in path.absolute().parents]
    else:
        tried = [path.absolute().parent / name.removeprefix("file://")]
    for candidate in tried:
        if candidate.is_file():
            return candidate
    raise FileNotFoundError(
        f"its mesh {name} is missing: there is no {tried[0]}"
        + (" nor a package of that name in a folder above" if tried[1:] else "")
    )


def _is_seen_only(geom: mujoco.MjsGeom) -> bool:
    return not (geom.contype or geom.conaffinity)
