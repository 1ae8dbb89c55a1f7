import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch

import collaborative_gym as cg
from collaborative_gym.learning import run as running
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.config import (
    MODES,
    PENALTIES,
    Hyperparameters,
    Resources,
)
from collaborative_gym.learning.folder import BEST, LAST
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.rng import training_seed, validation_seed
from collaborative_gym.scene import Scene

TIMES = ("seconds", "core_seconds", "steps_per_second")

WITHOUT_TORCH = """
import sys
import numpy as np

class Forbid:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "skrl"):
            raise ImportError(f"{name} was asked for")

sys.meta_path.insert(0, Forbid())
import collaborative_gym as cg

for folder in sys.argv[1:]:
    policy = cg.load_policy(folder)
    sizes = policy.layout.observation_sizes
    rows = {agent: np.ones((2, size), np.float32) for agent, size in sizes.items()}
    np.save(f"{folder}/actions.npy", np.concatenate(list(policy(rows).values()), 1))
"""


def untimed(rows):
    """Return rows without what a clock says."""
    return [{k: v for k, v in row.items() if k not in TIMES} for row in rows]


def interrupted_after(steps):
    """Return what presses Ctrl-C once so many steps are done."""

    def interrupt(row, best):
        if row["steps"] >= steps:
            raise KeyboardInterrupt

    return interrupt


@pytest.mark.parametrize("mode", MODES)
def test_a_run_leaves_what_it_promises(read_progress, trained, mode, carry):
    result = trained(mode)
    assert result.steps == 128 and result.seconds > 0.0
    names = {entry.name for entry in result.folder.iterdir()}
    events = {name for name in names if name.startswith("events.out.tfevents")}
    files = (
        "config.json progress.csv curve.png last.pt best.pt policy.safetensors run.lock"
    )
    assert len(events) == 1 and names == events | set(files.split())
    settings = json.loads((result.folder / "config.json").read_text())
    own = json.loads(json.dumps(result.settings.to_dict()))
    assert settings.pop("digest") and settings == own
    assert settings["mode"] == mode and settings["identity"]["task"] == "Carry"
    rows = read_progress(result.folder)
    assert [row["steps"] for row in rows] == [32, 64, 96, 128]
    validated = [row["steps"] for row in rows if "validation/return" in row]
    assert validated == [64, 128]
    for row in rows:
        assert all(np.isfinite(value) for value in row.values())
    assert result.best["steps"] in validated
    policy = result.policy()
    assert policy.metadata["steps"] == result.best["steps"]
    assert policy.metadata["mode"] == mode and policy.metadata["backend"] == "skrl"
    report = cg.evaluate(
        carry(), policy, episodes=4, seed=validation_seed(0), num_threads=1
    )
    assert report.mean_reward.mean == result.best["validation/return"]


def test_a_hyperparameter_among_the_options_is_told_where_it_belongs(carry_id):
    with pytest.raises(TypeError, match=r"come in hyperparameters=cg\.Hyperparam"):
        cg.train(carry_id, total_steps=10)


def test_policies_run_without_torch(trained):
    folders = [trained(mode).folder for mode in MODES]
    arguments = [sys.executable, "-c", WITHOUT_TORCH, *map(str, folders)]
    subprocess.run(arguments, check=True)
    for folder in folders:
        policy = cg.load_policy(folder)
        sizes = policy.layout.observation_sizes
        rows = {a: np.ones((2, size), np.float32) for a, size in sizes.items()}
        expected = np.concatenate(list(policy(rows).values()), axis=1)
        assert np.array_equal(np.load(folder / "actions.npy"), expected)
        (folder / "actions.npy").unlink()


def test_the_robots_learn(read_progress, train_tiny, tiny):
    numbers = Hyperparameters(
        total_steps=32 * 12 * 20,
        num_envs=32,
        rollout_steps=12,
        epochs=4,
        minibatch_size=96,
        learning_rate=1e-3,
        target_kl=0.02,
        initial_std=0.4,
        discount=0.9,
        hidden_sizes=(32, 32),
        validation_interval=0,
        validation_episodes=8,
    )
    result = train_tiny(hyperparameters=numbers)
    returns = [row["return"] for row in read_progress(result.folder) if "return" in row]
    spread = np.std(returns[:3])
    assert np.mean(returns[-3:]) > np.mean(returns[:3]) + 3.0 * max(spread, 0.2)


def test_noise_shrinks_over_the_last_steps(read_progress, train_tiny, tiny):
    numbers = tiny(
        learning_rate=0.0,
        target_kl=0.0,
        min_learning_rate=0.0,
        validation_interval=0,
        final_noise=0.25,
        quiet_share=0.5,
    )
    folder = train_tiny(hyperparameters=numbers).folder
    first, *_ = spread = [row["team/std"] for row in read_progress(folder)]
    # Each update is told before the noise shrinks after it.
    assert np.allclose(spread, np.array([1.0, 1.0, 1.0, 0.5]) * first)
    actor = Checkpoint.load(folder / LAST).backend["learners"]["team"]["policy"]
    last = actor["actor.log_std"].exp().mean()
    assert float(last) == pytest.approx(0.25 * first, rel=1e-5)


def test_noise_of_a_longer_run_ends_where_it_says(read_progress, train_tiny, tiny):
    given = {"validation_interval": 0, "final_noise": 0.25, "quiet_share": 1.0}
    still = {"learning_rate": 0.0, "target_kl": 0.0, "min_learning_rate": 0.0}
    folder = train_tiny(hyperparameters=tiny(**given, **still)).folder
    longer = tiny(**given, **still, total_steps=2 * tiny().total_steps)
    train_tiny(resume=folder, hyperparameters=longer)
    spread = np.array([row["team/std"] for row in read_progress(folder)])
    half = len(spread) // 2
    # It waits where the short run left it, because a long one would be louder there.
    assert np.allclose(spread[half:], 0.25 * spread[0])
    assert np.all(np.diff(spread[:half]) < 0.0)


@pytest.mark.parametrize("mode", MODES)
def test_a_resumed_run_equals_the_uninterrupted_one(
    read_progress, trained, train_tiny, tmp_path, mode, same
):
    whole, folder = trained(mode).folder, tmp_path / "cut"
    with pytest.raises(KeyboardInterrupt):
        options = {"checkpoint_interval": 64, "on_row": interrupted_after(96)}
        train_tiny(folder, mode=mode, **options)
    assert Checkpoint.load(folder / LAST).backend["steps"] == 64
    assert len(read_progress(folder)) == 3
    torch.rand(3)  # What else draws from the generator must not matter.
    result = train_tiny(resume=folder)
    assert result.steps == 128 and result.settings.mode == mode
    name = "policy.safetensors"
    assert (folder / name).read_bytes() == (whole / name).read_bytes()
    tables = [read_progress(each) for each in (whole, folder)]
    assert untimed(tables[0]) == untimed(tables[1])
    for name in (LAST, BEST):
        ends = [Checkpoint.load(each / name) for each in (whole, folder)]
        assert same(ends[0].backend, ends[1].backend)
        assert ends[0].best == ends[1].best
        assert untimed(ends[0].rows) == untimed(ends[1].rows)


def test_ctrl_c_is_heeded_after_the_update_and_the_second_one_at_once(
    train_tiny, tmp_path, capfd
):
    def press(times):
        def interrupt(row, best):
            if row["steps"] == 96:
                for _ in range(times):
                    signal.raise_signal(signal.SIGINT)

        return interrupt

    options = {"checkpoint_interval": 64}
    with pytest.raises(
        KeyboardInterrupt, match="after 96 steps; continue with --resume"
    ):
        train_tiny(tmp_path / "once", on_row=press(1), **options)
    assert Checkpoint.load(tmp_path / "once" / LAST).backend["steps"] == 96
    assert "stopping after the current update; Ctrl-C again" in capfd.readouterr().err
    with pytest.raises(
        KeyboardInterrupt, match="stopped at once; continue with --resume"
    ):
        train_tiny(tmp_path / "twice", on_row=press(2), **options)
    assert Checkpoint.load(tmp_path / "twice" / LAST).backend["steps"] == 64
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_another_seed_is_another_run(read_progress, trained, train_tiny):
    rows = [
        untimed(read_progress(result.folder))
        for result in (trained("collaborative"), train_tiny(seed=1))
    ]
    assert rows[0] != rows[1]


def test_training_leaves_the_callers_generator_and_threads(train_tiny):
    torch.manual_seed(3)
    expected = torch.rand(1)
    torch.manual_seed(3)
    threads = torch.get_num_threads()
    train_tiny(hyperparameters=Hyperparameters(total_steps=1, num_envs=2))
    assert torch.rand(1) == expected
    assert torch.get_num_threads() == threads


def test_more_steps_may_be_asked_for(read_progress, train_tiny, tiny, trained, same):
    first = train_tiny(hyperparameters=tiny(total_steps=64))
    assert first.steps == 64
    result = train_tiny(resume=first.folder, hyperparameters=tiny())
    assert result.steps == 128 and result.settings.hyperparameters == tiny()
    whole, went_on = (
        Checkpoint.load(folder / LAST).backend
        for folder in (trained("collaborative").folder, first.folder)
    )
    assert same(whole, went_on)
    assert result.seconds > first.seconds
    rows = len(read_progress(first.folder))
    again = train_tiny(resume=first.folder)
    assert (again.steps, again.best) == (128, result.best)
    assert len(read_progress(first.folder)) == rows


def test_what_was_half_written_is_removed(train_tiny):
    folder = train_tiny().folder
    (folder / ".last.abc.partial").mkdir()
    (folder / ".last.abc.partial" / LAST).write_bytes(b"half")
    train_tiny(resume=folder)
    assert not list(folder.glob(".*"))


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"mode": "shared"}, "mode is shared, not collaborative; leave out what"),
        ({"seed": 1}, "seed is 1, not 0"),
        ({"world": {"robots": ("panda", "jaco")}}, "robot_2 is jaco, not panda"),
        ({"world": {"randomization": "paper"}}, "joint_noise is 0.0, not"),
        ({"backend": "ray"}, "backend is ray, not skrl"),
        ({"hidden_sizes": (8, 8)}, r"hidden_sizes is \(8, 8\), not \(16, 16\)"),
        ({"discount": 0.5}, "discount is 0.5, not [0-9.]+"),
        ({"total_steps": 64}, "total_steps is 64, not 128"),
        ({"task": "Poke"}, "environment is Poke, not CarryPandas-v0"),
    ],
)
def test_another_run_than_asked_for_is_refused(
    carry_id, train_tiny, tiny, hashes, tmp_path, asked, message
):
    folder = train_tiny(task=carry_id).folder
    before = hashes(tmp_path)
    options = {"task": carry_id, **asked}
    if "world" in options:
        options["task"] = cg.task(carry_id, **options.pop("world"))
    for name in ("hidden_sizes", "discount", "total_steps"):
        if name in options:
            options["hyperparameters"] = tiny(**{name: options.pop(name)})
    with pytest.raises(ValueError, match=message):
        train_tiny(resume=folder, **options)
    assert hashes(tmp_path) == before


def test_a_damaged_or_missing_checkpoint_changes_nothing(train_tiny, hashes, tmp_path):
    folder = train_tiny().folder
    (folder / LAST).write_bytes((folder / LAST).read_bytes()[:-1000])
    before = hashes(tmp_path)
    with pytest.raises(
        ValueError, match=r"last.pt is damaged: .*; copy best.pt over it"
    ):
        train_tiny(resume=folder)
    with pytest.raises(FileNotFoundError, match=r"no checkpoint .*nowhere.last.pt"):
        train_tiny(resume=tmp_path / "nowhere")
    assert hashes(tmp_path) == before


def test_a_folder_with_a_run_is_not_overwritten(train_tiny, hashes, tmp_path):
    train_tiny()
    before = hashes(tmp_path)
    with pytest.raises(FileExistsError, match=r"continue it \(--resume\), or choose"):
        train_tiny()
    with pytest.raises(ValueError, match="either output, for a new run, or resume"):
        train_tiny(output=tmp_path / "a", resume=tmp_path / "run")
    assert hashes(tmp_path) == before


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"mode": "alone"}, ValueError, "no mode 'alone'; modes: centralized"),
        ({"backend": "jax"}, ValueError, "no backend 'jax'; backends: ray, skrl"),
        ({"seed": -1}, ValueError, "seed must be at least 0"),
        ({"seed": 1 << 40}, ValueError, "a training seed must be below 2"),
        ({"resources": Resources(device="gpu")}, ValueError, "give cpu or cuda"),
        ({"resources": Resources(device="meta")}, ValueError, "give cpu or cuda"),
        ({"checkpoint_interval": 0}, ValueError, "must be at least 1"),
        ({"task": "Cary"}, KeyError, "did you mean 'Carry'"),
    ],
)
def test_bad_input_shows_before_the_work(
    carry_id, train_tiny, tmp_path, options, error, message
):
    with pytest.raises(error, match=message):
        train_tiny(**options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"resources": Resources(num_collectors=2)}, "--backend ray too"),
        ({"resources": Resources(ray_address="a:1")}, "ray_address would mean nothing"),
        ({"hyperparameters": Hyperparameters(population=5)}, "--partner population"),
        ({"hyperparameters": Hyperparameters(league_fresh=0.5)}, "--opponent league"),
    ],
)
def test_numbers_of_what_is_not_asked_for_are_refused(
    train_tiny, tmp_path, options, message
):
    with pytest.raises(ValueError, match=message):
        train_tiny(**options)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_missing_device_is_named(train_tiny, tmp_path):
    with pytest.raises(ValueError, match="torch finds no CUDA device here"):
        train_tiny(resources=Resources(device="cuda"))
    assert not list(tmp_path.iterdir())


def test_a_run_is_named_after_what_it_learns(
    carry_id, train_tiny, tiny, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    result = cg.train(
        carry_id,
        "independent",
        seed=np.int64(2),
        hyperparameters=tiny(total_steps=1),
        resources=Resources(num_threads=1, torch_threads=1),
    )
    assert str(result.folder) == "runs/CarryPandas-v0-independent-seed2"
    assert cg.load_policy(result.folder).identity.name == carry_id


@pytest.mark.parametrize("mode", ["collaborative", "independent"])
def test_a_loss_that_is_not_finite_stops_the_run(
    train_tiny, carry, tmp_path, monkeypatch, mode
):
    task, reward = carry(), type(carry()).reward
    updates = []

    def spoiled(self, facts, commands):
        terms = reward(self, facts, commands)
        if len(updates) == 2:
            terms["robot_2"]["effort"] = np.full_like(facts.height, 3e38)
        return terms

    monkeypatch.setattr(type(task), "reward", spoiled)
    last = tmp_path / "run" / LAST
    learner = "team" if mode == "collaborative" else "robot_2"
    message = f"_loss of {learner} is (nan|inf) after 96 steps; .* checkpoint is {last}"
    with pytest.raises(RuntimeError, match=message):
        train_tiny(
            task=task,
            mode=mode,
            checkpoint_interval=32,
            on_row=lambda row, best: updates.append(row),
        )
    assert Checkpoint.load(last).backend["steps"] == 64
    assert not list(last.parent.glob(".*"))


def test_progress_is_shown_beside_what_else_gets_the_rows(train_tiny, capsys):
    steps = []
    train_tiny(on_row=lambda row, best: steps.append(row["steps"]), progress=True)
    assert len(steps) > 1
    assert f"Carry, {steps[-1]} of {steps[-1]} steps (100 %)" in capsys.readouterr().err


def test_a_full_disk_names_the_file_and_leaves_what_was_there(
    train_tiny, tiny, tmp_path, monkeypatch
):
    written = []

    def full_after_two(file):
        written.append(file)
        if len(written) > 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_after_two)
    last = tmp_path / "run" / LAST
    with pytest.raises(OSError, match=f"cannot write {last}: No space left on device"):
        train_tiny(hyperparameters=tiny(validation_interval=0), checkpoint_interval=32)
    assert Checkpoint.load(last).backend["steps"] == 32
    assert not list(last.parent.glob(".*"))


def test_nobody_is_chosen_by_the_episodes_of_training(
    train_tiny, tmp_path, monkeypatch
):
    seeds = {"trained": set(), "validated": set()}
    evaluate, advance = running.evaluate, running.Run.advance

    def validating(task, policy, **options):
        report = evaluate(task, policy, **options)
        seeds["validated"] |= {row["seed"] for row in report.episodes}
        return report

    def learning(self, *given):
        iteration = advance(self, *given)
        seeds["trained"] |= {row["seed"] for row in iteration.episodes}
        return iteration

    monkeypatch.setattr(running, "evaluate", validating)
    monkeypatch.setattr(running.Run, "advance", learning)
    for seed in (0, 5):
        train_tiny(tmp_path / f"{seed}", seed=seed)
    assert seeds["trained"] == {training_seed(0), training_seed(5)}
    assert seeds["validated"] == {validation_seed(0), validation_seed(5)}
    assert not seeds["trained"] & seeds["validated"]


def test_the_best_is_the_best_validated(train_tiny, tiny, tmp_path, monkeypatch):
    evaluate, given = running.evaluate, iter([1.0, 3.0, 3.0, 2.0])

    def as_given(*arguments, **options):
        report = evaluate(*arguments, **options)
        score = next(given)
        object.__setattr__(report.mean_reward, "mean", score)
        return report

    monkeypatch.setattr(running, "evaluate", as_given)
    numbers = tiny(validation_interval=32, **dict.fromkeys(PENALTIES, 0.0))
    result = train_tiny(hyperparameters=numbers)
    assert result.best["validation/return"] == 3.0
    assert result.best["steps"] == 64
    best = Checkpoint.load(result.folder / BEST)
    assert best.backend["steps"] == 64 and best.best == result.best
    assert Checkpoint.load(result.folder / LAST).best == result.best
    policy = NetworkPolicy.load(result.folder / "policy.safetensors")
    assert policy.metadata["steps"] == 64


def test_where_more_is_charged_the_latest_of_the_equally_good_is_best(
    train_tiny, tiny, monkeypatch
):
    evaluate = running.evaluate
    given = iter([(0.5, 9.0), (1.0, 3.0), (0.997, 2.0), (0.9, 5.0)])

    def as_given(*arguments, **options):
        report = evaluate(*arguments, **options)
        completion, score = next(given)
        object.__setattr__(report.completion, "mean", completion)
        object.__setattr__(report.mean_reward, "mean", score)
        return report

    monkeypatch.setattr(running, "evaluate", as_given)
    result = train_tiny(hyperparameters=tiny(validation_interval=32))
    assert result.best["steps"] == 96 and result.best["validation/return"] == 2.0


def test_a_run_compiles_one_world(train_tiny, tiny, monkeypatch):
    compiled, own = [], Scene.compile
    monkeypatch.setattr(Scene, "compile", lambda s: compiled.append(s) or own(s))
    train_tiny(hyperparameters=tiny(contact_penalty=0.1))
    assert len(compiled) == 1


def test_episodes_begin_after_mishaps_but_validations_do_not(carry, train_tiny, tiny):
    begun = []

    class Slips(type(carry())):
        def mishap(self, sim, env_ids, *, rng):
            begun.append((self.config.randomization.lost, len(env_ids)))

    task = Slips(list(carry().robots.values()), carry().config)
    result = train_tiny(task=task, hyperparameters=tiny(mishaps=0.5))
    assert sum(count for _, count in begun) > 0
    assert {lost for lost, _ in begun} == {0.5}
    assert result.policy().identity.config["randomization"]["lost"] == 0.0


def test_a_task_without_mishaps_refuses_them(train_tiny, tiny, tmp_path):
    with pytest.raises(ValueError, match=r"Carry has no mishap\(\)"):
        train_tiny(hyperparameters=tiny(mishaps=0.5))
    assert not list(tmp_path.iterdir())
