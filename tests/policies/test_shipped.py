import pytest

import collaborative_gym as cg
from collaborative_gym.policies.policy import BASELINES
from collaborative_gym.tasks.registry import as_task

SHIPPED = sorted(path.stem for path in BASELINES.glob("*.safetensors"))
ARE_OPPONENTS = [env_id for env_id in SHIPPED if len(as_task(env_id).sides) > 1]


def test_baselines_are_of_environments_small_and_each_has_a_card():
    assert SHIPPED and set(SHIPPED) <= set(cg.list_envs())
    assert {path.stem for path in BASELINES.glob("*.md")} == set(SHIPPED)
    sizes = [path.stat().st_size for path in BASELINES.iterdir()]
    assert sum(sizes) < 10_000_000
    for env_id in SHIPPED:
        command = f"collaborative-gym train {env_id} --seed"
        assert command in (BASELINES / f"{env_id}.md").read_text()


@pytest.mark.parametrize("env_id", sorted({*SHIPPED} - {*ARE_OPPONENTS}))
def test_a_baseline_does_its_task(env_id):
    """It fails where a world has changed: train that baseline anew."""
    report = cg.evaluate(env_id, "baseline", episodes=8, randomization="paper")
    assert report.completion.mean == 1.0
    assert report.performance.mean > 0.94


@pytest.mark.parametrize("env_id", ARE_OPPONENTS)
def test_a_baseline_beats_who_does_nothing_from_either_seat(env_id):
    played = cg.tournament(env_id, ["baseline", "idle"], episodes=4)
    taken = played.values["points"][:, 0, 1]
    assert (taken.mean(axis=1) > 0.6).all()
