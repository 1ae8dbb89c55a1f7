"""What the house may not outgrow unseen: lines, and what a function takes."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))

LONG = {
    "descend",
    "search",
    "train",
    "train_all",
    "tournament",
    "evaluate",
    "record",
    "report_card",
}
"""Functions of more than 40 lines of code, or of more than 8 parameters; those of the
public API are mostly their parameters. None may join them."""


def code_lines(function, lines):
    """Return a function's lines but for its docstring, comments and empty ones."""
    has_docstring = ast.get_docstring(function) is not None
    first = function.body[0]
    own = [
        lines[i - 1].strip()
        for i in range(function.lineno, function.end_lineno + 1)
        if not (has_docstring and first.lineno <= i <= first.end_lineno)
    ]
    return sum(bool(line) and not line.startswith("#") for line in own)


def functions(path):
    text = path.read_text()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef) and node.name != "__init__":
            given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
            taken = [each for each in given if each.arg not in ("self", "cls")]
            yield node.name, code_lines(node, text.splitlines()), len(taken)


def test_the_package_does_not_grow():
    assert sum(len(path.read_text().splitlines()) for path in SOURCES) <= 37_600


@pytest.mark.parametrize(
    "path", SOURCES, ids=lambda path: str(path.relative_to(ROOT / "src"))
)
def test_files_and_functions_are_short(path):
    assert len(path.read_text().splitlines()) <= 500
    for name, lines, parameters in functions(path):
        assert name in LONG or (lines <= 40 and parameters <= 8), name


def test_no_function_is_called_long_that_is_not():
    found = {
        name
        for path in SOURCES
        for name, lines, parameters in functions(path)
        if lines > 40 or parameters > 8
    }
    assert found == LONG
