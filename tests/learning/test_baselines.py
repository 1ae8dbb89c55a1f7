import re
from types import SimpleNamespace
from typing import Any

import pytest

import collaborative_gym as cg
from collaborative_gym.evaluation.report import format_statistic
from collaborative_gym.learning import baselines, config
from collaborative_gym.learning.baselines import write_baseline
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.config import changed, recipe
from collaborative_gym.learning.folder import LAST


@pytest.fixture
def train_both(carry_id, undrawn, tiny, alone, tmp_path, monkeypatch):
    """Return a function that trains the small task's baseline, of two runs."""
    four = dict.fromkeys(baselines._EPISODES, 4)
    monkeypatch.setattr(baselines, "_EPISODES", four)
    monkeypatch.setattr(baselines, "_CHOICE_EPISODES", 4)

    def train_both(changes=None, output=tmp_path, drawn="default", **options):
        changes = changes or changed(tiny(total_steps=64))
        results = [
            cg.train(
                cg.task(carry_id, randomization=drawn),
                "collaborative",
                seed=seed,
                output=output / f"seed{seed}",
                hyperparameters=recipe(carry_id, changes=changes),
                resources=alone,
                **options,
            )
            for seed in (0, 1)
        ]
        return write_baseline(results, output, alone)

    return train_both


def runs(folder):
    """Return what stands for the two runs of a folder."""
    for seed in (0, 1):
        policy = folder / f"seed{seed}"
        run: Any = SimpleNamespace(policy=lambda policy=policy: policy)
        yield run


def test_the_better_run_is_shipped_with_its_card(train_both, carry_id, alone, tmp_path):
    assert train_both() == tmp_path / f"{carry_id}.md"
    names = {entry.name for entry in tmp_path.iterdir()}
    files = {f"{carry_id}{suffix}" for suffix in (".md", ".png", ".safetensors")}
    assert names == {"seed0", "seed1"} | files
    ranks = [baselines._rank(carry_id, run, alone) for run in runs(tmp_path)]
    best = ranks.index(max(ranks))
    shipped = tmp_path / f"{carry_id}.safetensors"
    policy = cg.load_policy(shipped)
    assert policy.metadata["seed"] == best
    own = tmp_path / f"seed{best}" / "policy.safetensors"
    assert shipped.read_bytes() == own.read_bytes()
    card = (tmp_path / f"{carry_id}.md").read_text()
    assert f"--seed {best} " in card and "--hidden-sizes 16 16" in card
    own = "total_steps 64, num_envs 4, rollout_steps 8"
    assert f"- non-default hyperparameters: {own}" in card
    rows = [line for line in card.splitlines() if re.match(r"\| [01] ", line)]
    assert len(rows) == 6
    shown = [row for row in rows if "(shipped)" in row]
    assert len(shown) == 3 and all(f"| {best} (shipped)" in row for row in shown)
    conditions = {
        "paper": ("paper", 0),
        "default": ("default", 0),
        "default, late": ("default", 1),
    }
    for starts, (drawn, delay) in conditions.items():
        task = cg.task(carry_id, randomization=drawn)
        how = {"episodes": 4, "num_threads": 1, "delay": delay}
        report = cg.evaluate(task, policy, **how)
        (row,) = [row for row in shown if f"| {starts} |" in row]
        assert f"| {format_statistic(report.mean_reward)} |" in row


def test_of_equal_runs_the_one_whose_arms_keep_apart_is_better(alone, monkeypatch):
    monkeypatch.setattr(baselines, "_CHOICE_EPISODES", 2)

    def rank(policy):
        run: Any = SimpleNamespace(policy=lambda: policy)
        return baselines._rank("PassTaskSawyers-v0", run, alone)

    idle, random, expert = map(rank, ("idle", "random", "expert"))
    # The expert's hands come within millimetres of one another.
    assert expert > idle > random and idle[:2] == random[:2] and expert[2] < idle[2]
    assert idle[2] == pytest.approx(random[2], abs=1.0) and idle[3] > random[3]


def test_a_card_says_if_the_expert_was_a_guide():
    first = {"seed": 0, "steps": 2e6, "hyperparameters": {"imitation": 2.0}}
    guide = "with the expert's advice"
    assert baselines._beginning(first) == f"from scratch {guide}"
    start = {"start_from": "runs/a", "start": {"digest": "1f", "metadata": first}}
    text = baselines._beginning({"hyperparameters": {}, **start})
    assert f"2.00 M steps of seed 0 {guide} (digest 1f). The last run, w" in text
    second = first | start
    assert f"(digest 1f). The last run, {guide}" in baselines._beginning(second)
    third = first | {"start_from": "b", "start": {"digest": "2a", "metadata": second}}
    text = baselines._beginning(third)
    assert text.startswith("in 3 runs, each from the policy of the run before. First")
    assert text.index("digest 1f") < text.index("digest 2a")


def test_a_card_says_with_what_its_run_began(train_both, tmp_path, monkeypatch):
    card = train_both()
    assert " from scratch without demonstrations. The mode" in card.read_text()
    first = cg.load_policy(card.with_suffix(".safetensors"))
    monkeypatch.chdir(tmp_path)
    start = card.with_suffix(".safetensors").name
    card = train_both(output=tmp_path / "more", start_from=start, drawn="wide")
    text = card.read_text()
    assert "in 2 runs, each from the policy of the run before. First came 0.00" in text
    assert f" without demonstrations (digest {first.digest[:12]}). The last" in text
    # All runs that led to it can be trained again, one after another.
    commands = [line for line in text.splitlines() if line.startswith("- command")]
    assert [line.partition(":")[0] for line in commands] == [
        "- command 1 of 2",
        "- command 2 of 2",
    ]
    assert "--start-from" not in commands[0] and "wide" not in commands[0]
    assert commands[0].endswith(" --output runs/part_1`")
    assert commands[1].endswith("--start-from runs/part_1 --randomization wide`")


def test_a_card_says_with_whom_its_run_learned(train_both):
    text = train_both(partner=["expert"]).read_text()
    assert " --partner expert`" in text


def test_what_is_changed_is_laid_over_the_recipe(
    train_both, carry_id, tiny, tmp_path, monkeypatch
):
    recipes = {carry_id: {"assistance": 0.5, "discount": 0.9}}
    monkeypatch.setattr(config, "RECIPES", recipes)
    card = train_both(changed(tiny(total_steps=64, discount=0.8)))
    settings = Checkpoint.load(tmp_path / "seed0" / LAST).settings
    assert settings.hyperparameters.assistance == 0.5
    assert settings.hyperparameters.discount == 0.8
    assert "the simulator carried 50 % of the weight" in card.read_text()
    assert "--discount 0.8" in card.read_text()


def test_a_card_says_how_starts_were_drawn(train_both):
    text = train_both(drawn="wide").read_text()
    assert "randomization `wide`" in text and " --randomization wide`" in text
