"""Tasks and arms of a user's own, from files and from installed packages."""

import sys
from importlib.metadata import EntryPoint

import pytest

import collaborative_gym as cg
from collaborative_gym import plugins
from collaborative_gym.cli.main import main

TASK = """
from my_settings import REACH
import collaborative_gym as cg

class Wave(cg.Task):
    reach = REACH

cg.register_task("Wave", Wave)
"""


@pytest.fixture
def wave(tmp_path, monkeypatch, carry_id):
    """Return the path of a file that registers a task; it is forgotten afterwards."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(plugins, "_loaded", {})
    monkeypatch.setattr(plugins, "_registering", set())
    (tmp_path / "my_settings.py").write_text("REACH = 0.5\n")
    path = tmp_path / "my_wave.py"
    path.write_text(TASK)
    yield path
    for name in ("my_wave", "my_settings"):
        sys.modules.pop(name, None)


def test_a_file_registers_its_tasks_once(wave, tmp_path, monkeypatch):
    module = cg.load_module(str(wave))
    assert "Wave" in cg.list_tasks()
    assert module.Wave.reach == 0.5
    assert module.Wave.__module__ == "my_wave"
    monkeypatch.chdir(tmp_path)
    assert cg.load_module("my_wave.py") is module


def test_an_installed_module_is_loaded_by_name(wave, monkeypatch):
    monkeypatch.syspath_prepend(wave.parent)
    assert cg.load_module("my_wave").Wave.reach == 0.5


def test_the_location_of_an_error_is_the_users_line(wave):
    wave.write_text(TASK + "\n\ndef lift(height):\n    return cg.make(height)\n")
    module = cg.load_module(str(wave))
    with pytest.raises(KeyError) as caught:
        module.lift("no such environment")
    assert plugins.location_of(caught.value) == "my_wave.py, line 12, in lift"
    with pytest.raises(KeyError) as caught:
        cg.make("no such environment")
    assert plugins.location_of(caught.value) == ""


@pytest.mark.parametrize(
    ("line", "message", "status"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero (my_wave.py, line 11)", 2),
        ("{}[3]", "KeyError: 3 (my_wave.py, line 11)", 2),
        ("import no_such", "ModuleNotFoundError: No module named 'no_such' (", 1),
        (
            "cg.get_robot('pand')",
            "no robot 'pand' (did you mean 'panda'?); robots: fr3, gen3, iiwa14, jaco,",
            2,
        ),
    ],
)
def test_the_command_line_tells_where_a_file_is_wrong(
    wave, capsys, line, message, status
):
    wave.write_text(f"{TASK}\n\n{line}\n")
    assert main(["evaluate", "Poke", "--module", str(wave)]) == status
    printed = capsys.readouterr().err
    assert printed.startswith(f"error: {message}")
    assert printed.count("\n") == 1 and "(my_wave.py, line 11)" in printed


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("nowhere.py", FileNotFoundError, "there is no file nowhere.py"),
        ("no_such.module", KeyError, "no module 'no_such.module' is installed"),
        ("os", ValueError, "module os registers no task, environment or arm"),
        ("x\0.py", ValueError, "module must be a path"),
    ],
)
def test_a_module_that_is_missing(name, error, message):
    with pytest.raises(error, match=message):
        cg.load_module(name)


def test_a_file_named_as_a_library(wave):
    other = wave.with_name("numpy.py")
    other.write_text("")
    with pytest.raises(ValueError, match="another module named 'numpy'; rename"):
        cg.load_module(str(other))


@pytest.mark.parametrize(
    ("text", "error"),
    [("import nothing_of_this_name\n", ModuleNotFoundError), ("x = 1\n", ValueError)],
)
def test_a_file_that_fails_or_registers_nothing_can_be_mended(wave, text, error):
    wave.write_text(text)
    with pytest.raises(error, match=r"nothing_of_this_name|registers no task"):
        cg.load_module(str(wave))
    wave.write_text(TASK)
    assert cg.load_module(str(wave)).Wave.reach == 0.5


def test_packages_bring_tasks_and_a_broken_one_is_named(wave, monkeypatch):
    monkeypatch.syspath_prepend(wave.parent)
    entries = [
        EntryPoint("broken", "no_such_module", plugins.GROUP),
        EntryPoint("wave", "my_wave", plugins.GROUP),
    ]
    asked = []

    def found(*, group):
        asked.append(group)
        return entries

    monkeypatch.setattr(plugins, "entry_points", found)
    with pytest.warns(UserWarning, match=r"\(no_such_module\) cannot be loaded"):
        plugins.load_entry_points()
    assert asked == ["collaborative_gym.tasks"]
    assert "Wave" in cg.list_tasks()
