"""Folders of runs that were never trained: what a comparison reads, and no more."""

import json
from copy import deepcopy

import pytest

from collaborative_gym.blocks import Layout
from collaborative_gym.files import SealedRows, read_sealed, sealed
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.settings import Settings
from collaborative_gym.tasks.identity import Identity

COLUMNS = "steps,core_seconds,return,validation/return,validation/completion"


def write_progress(path, rows):
    """Write the lines of a run, as dictionaries of cells."""
    lines = SealedRows(dict.fromkeys(name for row in rows for name in row))
    path.write_text(lines.header + "".join(map(lines.line, rows)))


@pytest.fixture
def alter():
    """Return a function that changes what a run's file says, as another run's would."""

    def alter(path, change):
        if path.suffix == ".json":
            content = read_sealed(path, "")
            change(content)
            path.write_text(sealed(content))
        else:
            rows = SealedRows.read(path, "")
            change(rows)
            write_progress(path, rows)

    return alter


@pytest.fixture
def contents(carry):
    """Return a run's settings, as `config.json` has them."""
    settings = Settings(
        identity=Identity.of(carry()),
        mode="collaborative",
        seed=0,
        backend="skrl",
        layout=Layout({}, {}),
        hyperparameters=Hyperparameters(total_steps=400),
    )
    return json.loads(json.dumps(settings.to_dict()))


@pytest.fixture
def write_run(contents, tmp_path):
    """Return a function that writes a run's folder, by its validated completions."""

    def write_run(
        name,
        completions,
        seed=0,
        env="CarryPandas-v0",
        mode=None,
        algorithm="ppo",
        **numbers,
    ):
        content = deepcopy(contents)
        content["identity"]["name"] = env
        content["seed"], content["mode"] = seed, mode or content["mode"]
        content["algorithm"] = algorithm
        content["hyperparameters"] |= numbers
        folder = tmp_path / name
        folder.mkdir(parents=True)
        (folder / "config.json").write_text(sealed(content))
        rows = [(50, 1.0, -3.0, "", "")]
        for i, completion in enumerate(completions):
            steps = 100 * (i + 1)
            rows.append((steps, 2.5 * (i + 1), -1.0, 10 * completion, completion))
        columns = COLUMNS.split(",")
        cells = [dict(zip(columns, map(str, row), strict=True)) for row in rows]
        write_progress(folder / "progress.csv", cells)
        return folder

    return write_run


@pytest.fixture
def two_modes(write_run, tmp_path):
    """Write two modes of three seeds each, and return their folder."""
    for seed, last in enumerate((1.0, 0.9, 0.5)):
        write_run(f"both/c{seed}", (0.0, 0.2, 0.9, last), seed)
        write_run(
            f"both/i{seed}", (0.0, 0.1, 0.2, last - 0.3), seed, mode="independent"
        )
    return tmp_path / "both"
