"""What the house may not outgrow unseen."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))

LONG = {
    "adapters",
}


def code_lines(function, text):
    """Return how many lines of a function are neither its docstring, comment nor empty."""
    lines = text.splitlines()
    first = function.body[0]
    told = (
        range(first.lineno, first.end_lineno + 1)
        if ast.get_docstring(function) is not None
        else ()
    )
    return sum(
        1
        for i in range(function.lineno, function.end_lineno + 1)
        if i not in told and lines[i - 1].strip() and not lines[i - 1].strip().startswith("#")
    )


def functions(path):
    text = path.read_text()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
            own = [each for each in given if each.arg not in ("self", "cls")]
            yield f"{path.stem}.{node.name}", code_lines(node, text), len(own)


def test_the_package_does_not_grow():
    lines = sum(len(path.read_text().splitlines()) for path in SOURCES)
    assert lines <= 31_000


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_a_file_is_read_in_one_go(path):
    assert len(path.read_text().splitlines()) <= 500
