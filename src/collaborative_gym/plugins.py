"""Tasks and arms from elsewhere: a user's file, or an installed package."""

import importlib
import importlib.util
import os
import sys
import traceback
import warnings
from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from collaborative_gym.errors import UnknownName, check_name

GROUP = "collaborative_gym.tasks"
"""Entry points of this group name modules that register tasks, ids and arms."""

_loaded: dict[Path, ModuleType] = {}  # imported files

_tried: set[Path] = set()  # imported files, and those that failed

_registering: set[str] = set()
"""Names of modules that have registered something while they were imported."""


def note_registration() -> None:
    """Remember the modules that are imported now as modules that register something."""
    frame = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_name == "<module>":
            _registering.add(frame.f_globals.get("__name__", ""))
        frame = frame.f_back


def load_modules(names: Iterable[str]) -> None:
    """Import each of the modules by `load_module`."""
    for name in names:
        load_module(name)


def load_module(name: str) -> ModuleType:
    """Import a module that registers tasks, environment ids or arms.

    A file is imported once, under its own name; modules beside it can be imported as if
    it were run as a script.

    Args:
      name: a path that ends in .py, or the dotted name of an installed module.

    Raises:
      FileNotFoundError: if there is no such file.
      KeyError: if there is no such module.
      TypeError: if the name is not a string.
      ValueError: if another module of that name is loaded already, the file is not
        valid Python, or nothing was registered when it was imported.
    """
    check_name("module", name)
    if "\0" in name:
        raise ValueError(f"module must be a path or a dotted name, got {name!r}")
    if not name.endswith(".py"):
        module = _import(name)
        _check_registers(name, name)
        return module
    path = Path(os.path.realpath(name))  # which takes a circle of links, too
    if path in _loaded:
        return _loaded[path]
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {name}")
    if path.stem in sys.modules or path.stem in sys.stdlib_module_names:
        raise ValueError(
            f"{name}: there is another module named {path.stem!r}; rename the file"
        )
    # Before 3.11.4, Python raises a ValueError that names no file.
    if b"\0" in path.read_bytes():
        raise ValueError(f"module {name} is not Python: it contains null bytes")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    _tried.add(path)
    sys.path.insert(0, str(path.parent))
    sys.modules[path.stem] = module
    try:
        spec.loader.exec_module(module)
        _check_registers(name, path.stem)
    except BaseException as error:
        del sys.modules[path.stem]
        if isinstance(error, SyntaxError):
            line = f", line {error.lineno}" if error.lineno else ""
            text = f": {error.text.strip()}" if line and error.text else ""
            raise ValueError(
                f"module {name} is not Python{line}: {error.msg}{text}"
            ) from error
        raise
    _loaded[path] = module
    return module


def loaded_files() -> tuple[str, ...]:
    """Return the files that were imported, for another process to import them too."""
    return tuple(map(str, _loaded))


def location_of(error: BaseException, kind: type = object) -> str:
    """Return the innermost line of an error in files of `load_module`.

    An example is "my_task.py, line 41, in measure". Files of the classes from which a
    `kind` derives count too, unless they are this package's.
    """
    own, package = set(_tried), __name__.partition(".")[0]
    for base in kind.__mro__:
        file = getattr(sys.modules.get(base.__module__), "__file__", None)
        if file and base.__module__.partition(".")[0] != package:
            own.add(Path(file))
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if path in own:
            where = "" if frame.name == "<module>" else f", in {frame.name}"
            return f"{path.name}, line {frame.lineno}{where}"
    return ""


def load_entry_points() -> None:
    """Import the modules of installed packages in `GROUP`; warn where that fails."""
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:
            package = entry.dist.name if entry.dist else "a package"
            warnings.warn(
                f"the tasks of {package} ({entry.value}) cannot be loaded: {error!r}",
                stacklevel=2,
            )


def _check_registers(name: str, module: str) -> None:
    if not any(f"{own}.".startswith(f"{module}.") for own in _registering):
        raise ValueError(
            f"module {name} registers no task, environment or arm; it must call"
            " register_task, register_env or register_robot as it is imported"
        )


def _import(name: str) -> ModuleType:
    if not all(part.isidentifier() for part in name.split(".")):
        raise ValueError(
            f"module {name!r} is neither a path that ends in .py nor a dotted name"
        )
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if not name.startswith(error.name or "?"):
            raise
        raise UnknownName(
            f"no module {name!r} is installed; give a file as a path that ends in .py"
        ) from None
