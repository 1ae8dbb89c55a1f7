import pytest

import collaborative_gym as cg
from collaborative_gym.policies.policy import SHIPPED
from collaborative_gym.tasks.registry import as_task

IDS = {
    kind: sorted(path.stem for path in folder.glob("*.safetensors"))
    for kind, folder in SHIPPED.items()
}
ARE_OPPONENTS = [env_id for env_id in IDS["baseline"] if len(as_task(env_id).sides) > 1]


def test_baselines_are_of_environments_small_and_each_has_a_card():
    folder, ids = SHIPPED["baseline"], set(IDS["baseline"])
    assert ids and ids <= set(cg.list_envs())
    assert {path.stem for path in folder.glob("*.md")} == ids
    sizes = [path.stat().st_size for path in folder.iterdir()]
    assert sum(sizes) < 13_000_000
    for env_id in ids:
        command = f"collaborative-gym train {env_id} --seed"
        assert command in (folder / f"{env_id}.md").read_text()


@pytest.mark.parametrize("env_id", sorted({*IDS["baseline"]} - {*ARE_OPPONENTS}))
def test_a_baseline_does_its_task(env_id):
    """It fails where a world has changed: train that baseline anew."""
    report = cg.evaluate(cg.task(env_id, randomization="paper"), "baseline", episodes=8)
    assert report.completion.mean == 1.0
    assert report.performance.mean > 0.94


@pytest.mark.parametrize("env_id", ARE_OPPONENTS)
def test_a_baseline_beats_who_does_nothing_from_either_seat(env_id):
    played = cg.tournament(env_id, ["baseline", "idle"], episodes=4)
    taken = played.values["points"][:, 0, 1]
    assert (taken.mean(axis=1) > 0.6).all()


def test_egos_are_of_environments_and_small():
    assert IDS["ego"] and {*IDS["ego"]} <= {*cg.list_envs()}
    assert sum(path.stat().st_size for path in SHIPPED["ego"].iterdir()) < 5_000_000


@pytest.mark.parametrize("seat", ["robot_1", "robot_2"])
@pytest.mark.parametrize("env_id", IDS["ego"])
def test_an_ego_works_with_partners_of_another_convention(env_id, seat):
    partner = "expert:nearer" if env_id.startswith("Pass") else "expert"
    team = {"robot_1": partner, "robot_2": partner, seat: "ego"}
    report = cg.evaluate(env_id, team, episodes=8)
    assert report.completion.mean >= 0.75
