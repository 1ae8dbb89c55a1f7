import pytest

import collaborative_gym as cg
from collaborative_gym.learning import config
from collaborative_gym.learning.config import (
    ADVISED,
    RECIPES,
    Hyperparameters,
    changed,
    recipe,
)


def test_recipes_are_of_environments_and_others_get_the_defaults():
    assert set(RECIPES) <= set(cg.list_envs())
    for env_id, numbers in RECIPES.items():
        assert changed(recipe(env_id)) == dict(numbers)
    assert recipe("Carry") == Hyperparameters()


def test_advice_has_recipes_of_its_own():
    assert set(ADVISED) <= set(RECIPES)
    for env_id in cg.list_envs():
        numbers, usual = recipe(env_id, advised=True), recipe(env_id)
        assert numbers.imitation > 0 and not usual.imitation
        taken_back = ADVISED.get(env_id, {})
        assert taken_back.items() <= changed(numbers, usual).items()
        assert numbers.contact_penalty == usual.contact_penalty


def test_a_new_run_is_made_by_its_environments_recipe(
    monkeypatch, carry_id, tmp_path, tiny
):
    own = tiny(total_steps=64)
    given = changed(own)
    monkeypatch.setattr(config, "RECIPES", {carry_id: given})
    result = cg.train(
        carry_id, output=tmp_path, resources=config.Resources(num_threads=1)
    )
    assert result.settings.hyperparameters == own
    assert result.steps == 64


def test_what_changed_is_told_against_the_defaults_or_others():
    numbers = Hyperparameters(total_steps=5, discount=0.9)
    assert changed(numbers) == {"total_steps": 5, "discount": 0.9}
    assert changed(numbers, Hyperparameters(total_steps=5)) == {"discount": 0.9}


@pytest.mark.parametrize(
    ("name", "value"),
    [("grip_persistence", 1.0), ("discount", 1.1), ("num_envs", 0), ("clip", -0.2)],
)
def test_a_number_out_of_range_is_refused(name, value):
    with pytest.raises(ValueError, match=f"^{name} must be"):
        Hyperparameters(**{name: value})


def test_noise_that_stays_does_not_shrink_over_the_last_steps():
    with pytest.raises(ValueError, match=r"^quiet_share 0\.5 needs a final_noise"):
        Hyperparameters(quiet_share=0.5)
