"""The wheel holds all that the package needs, and runs where there is no checkout."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Return the path of the wheel, built with what is installed."""
    folder = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def elsewhere(wheel, tmp_path_factory):
    """Return a function that runs Python on the installed wheel, far from the code."""
    site = tmp_path_factory.mktemp("site")
    pip("install", "--no-deps", "--no-compile", "--target", site, wheel)
    folder = tmp_path_factory.mktemp("elsewhere")

    def run(*arguments):
        finished = subprocess.run(
            [sys.executable, "-P", *arguments],
            cwd=folder,
            # Before the checkout, which is installed too.
            env={**os.environ, "PYTHONPATH": str(site), "COLUMNS": "120"},
            capture_output=True,
            text=True,
        )
        assert finished.returncode == 0, finished.stderr
        return finished.stdout

    run.site, run.folder = site, folder
    return run


def pip(*arguments):
    subprocess.run(
        [sys.executable, "-m", "pip", "--quiet", "--no-input", *arguments], check=True
    )


def test_it_holds_the_package_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {
        "collaborative_gym",
        "collaborative_gym_command.py",
        f"{wheel.name.split('-py3')[0]}.dist-info",
    }
    source = ROOT / "src"
    expected = {
        str(path.relative_to(source))
        for path in (source / "collaborative_gym").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    } | {"collaborative_gym_command.py"}
    assert {name for name in names if ".dist-info/" not in name} == expected
    for needed in (
        "py.typed",
        "robots/sawyer.xml",
        "baselines/PokeTaskSawyers-v0.safetensors",
        "baselines/PokeTaskSawyers-v0.md",
        "egos/LiftTaskSawyers-v0.safetensors",
    ):
        assert f"collaborative_gym/{needed}" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert wheel.stat().st_size < 20_000_000


def test_it_plays_a_baseline(elsewhere):
    printed = elsewhere(
        "-c",
        "import collaborative_gym as cg; print(cg.__file__);"
        "report = cg.evaluate('PokeTaskSawyers-v0', 'baseline', episodes=2);"
        "print(report.completion.mean)",
    )
    where, completion = printed.split()
    assert Path(where).is_relative_to(elsewhere.site)
    assert float(completion) == 1.0


def test_every_environment_is_made(elsewhere):
    printed = elsewhere("-m", "collaborative_gym", "list")
    for env_id in ("LiftTaskJacos-v0", "PassTaskJacoSawyer-v0"):
        assert env_id in printed


def test_its_command_is_installed(elsewhere):
    command = elsewhere.site / "bin" / "collaborative-gym"
    printed = elsewhere(command, "--version")
    assert printed.startswith("collaborative-gym ")
    assert not list(elsewhere.folder.iterdir())
