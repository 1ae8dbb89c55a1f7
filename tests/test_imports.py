"""Imports go one way: from the rooms above to those below, and never round."""

import ast
import graphlib
from pathlib import Path

import pytest

import collaborative_gym

ROOT = Path(collaborative_gym.__file__).parent
PACKAGE = ROOT.name

# From bottom to top. A module belongs to the room of its longest name here; rooms on
# one line do not know of one another. CONTRIBUTING.md says what each is for.
ROOMS = [
    {"blocks", "errors", "math", "quiet", "timing"},
    {"rng", "files", "plugins"},
    {"robots"},
    {"objects"},
    {"sim"},
    {"scene"},
    {"motion"},
    {"control"},
    {"tasks"},
    {"pictures", "pictures.rendering"},
    {"envs"},
    {"policies"},
    {"evaluation"},
    {"tournaments"},
    {"learning"},
    {"cards", "certificate", "comparisons", "adapters"},
    {"pictures.recording"},
    {"viewer"},
    {"trying"},
    {"testing"},
    {""},
    {"cli"},
    {"__main__"},
]


def find_modules():
    """Return the files of the package's modules, by name within the package."""
    found = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__")] = path
    return found


def imports(source, known):
    """Return the modules that a source needs to run, also those in its functions."""
    found = set()
    for node in without_types(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            assert not node.level, "imports name modules in full"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                is_module = inner.removeprefix(f"{PACKAGE}.") in known
                found.add(inner if is_module else node.module)
    own = {name for name in found if name.partition(".")[0] == PACKAGE}
    return {name.removeprefix(PACKAGE).removeprefix(".") for name in own}


def without_types(node):
    """Yield a tree's nodes, but what only type checkers read."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test)):
            yield from without_types(child)


def room_of(module):
    """Return the name and the height of a module's room."""
    heights = {room: i for i, level in enumerate(ROOMS) for room in level}
    name = module
    while name not in heights:
        assert "." in name, f"no room of ROOMS holds {module}"
        name = name.rpartition(".")[0]
    return name, heights[name]


@pytest.fixture(scope="module")
def graph():
    """Return what each module imports of the package, by name."""
    known = find_modules()
    return {name: imports(path.read_text(), known) for name, path in known.items()}


def test_no_import_goes_round(graph):
    # Raises a CycleError that lists the modules of a circle.
    tuple(graphlib.TopologicalSorter(graph).static_order())


def test_imports_go_down(graph):
    upwards = []
    for module, others in graph.items():
        room, height = room_of(module)
        for other in others:
            below, depth = room_of(other)
            if depth >= height and below != room:
                upwards.append(f"{module} imports {other}")
    assert not upwards


def test_an_import_in_a_function_counts_and_one_for_type_checkers_does_not():
    source = """
from typing import TYPE_CHECKING
import numpy
from collaborative_gym import envs, make
if TYPE_CHECKING:
    from collaborative_gym.tasks import lift
def late():
    import collaborative_gym.cli.main
"""
    assert imports(source, find_modules()) == {"envs", "", "cli.main"}


def test_no_two_files_of_tests_have_one_name():
    """Pytest would collect the first alone, or none, by how it imports them."""
    names = [path.name for path in Path(__file__).parent.rglob("test_*.py")]
    assert sorted(set(names)) == sorted(names)
