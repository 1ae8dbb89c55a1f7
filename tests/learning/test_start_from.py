"""Runs that begin with a policy, not with networks drawn by chance."""

import numpy as np
import pytest

from collaborative_gym.blocks import Layout
from collaborative_gym.learning.checkpoint import Checkpoint
from collaborative_gym.learning.folder import LAST
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.team import make_learners

ALONE_STEPS, LATER_STEPS = 320, 352
"""Those of the ten rollouts in which critics learn alone, and one more."""


@pytest.fixture
def begin(train_tiny, tiny, trained, tmp_path):
    """Return a function that begins with a mode's finished policy."""

    def begin(steps, mode="collaborative", output=tmp_path / "more", **options):
        numbers = tiny(total_steps=steps, validation_interval=0, lost_grips=0.0)
        first = trained(mode).folder
        options = {"hyperparameters": numbers, "start_from": first} | options
        return train_tiny(output, mode=mode, **options)

    return begin


@pytest.mark.parametrize("mode", ["collaborative", "shared", "centralized"])
def test_the_policy_stays_while_the_critic_learns_and_is_changed_then(
    begin, trained, mode, tmp_path, same
):
    first = trained(mode).policy()
    for steps, stays in ((ALONE_STEPS, True), (LATER_STEPS, False)):
        result = begin(steps, mode, tmp_path / f"{steps}")
        weights = result.policy().weights
        for name, own in first.weights.items():
            assert same(own.layers, weights[name].layers) is stays
            # What it learned leans on these.
            assert np.allclose(own.mean, weights[name].mean, atol=1e-7)
            assert np.allclose(own.std, weights[name].std, rtol=1e-6)
    assert result.policy().metadata["start"]["digest"] == first.digest
    assert result.policy().metadata["start"]["metadata"] == first.metadata


def test_critics_learn_meanwhile(begin, same, tmp_path):
    values = [
        Checkpoint.load(
            begin(steps, output=tmp_path / f"{steps}").folder / LAST
        ).backend["learners"]["team"]["value"]
        for steps in (32, 64)
    ]
    assert not same(*values)


def test_it_goes_on_bit_for_bit(begin, train_tiny, tiny, tmp_path, same):
    whole = begin(LATER_STEPS, output=tmp_path / "whole")
    part = begin(ALONE_STEPS - 32, output=tmp_path / "part")
    numbers = tiny(total_steps=LATER_STEPS, validation_interval=0, lost_grips=0.0)
    again = train_tiny(resume=part.folder, hyperparameters=numbers)
    ends = [Checkpoint.load(each.folder / LAST).backend for each in (whole, again)]
    assert same(*ends)
    assert again.settings.start == whole.settings.start
    with pytest.raises(ValueError, match=r"start_from is expert, not .*run"):
        train_tiny(resume=part.folder, start_from="expert")


def test_a_run_from_scratch_goes_on_without_it(train_tiny, tiny):
    folder = train_tiny().folder
    again = train_tiny(resume=folder, hyperparameters=tiny(total_steps=160))
    assert again.settings.start_from == ""


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"start_from": "expert"}, ValueError, "must be a trained policy, got 'exp"),
        ({"start_from": "nobody"}, KeyError, "no policy 'nobody'"),
        ({"start_from": 3}, TypeError, "start_from must be a policy's name"),
        (
            {"mode": "independent", "start_from": "PokeTaskSawyers-v0"},
            ValueError,
            r"robot_1 has layers of \(21, 256, 256, 7\), not \(",
        ),
    ],
)
def test_another_start_is_refused_before_the_work(
    train_tiny, tmp_path, options, error, message
):
    with pytest.raises(error, match=message):
        train_tiny(**options)
    assert not list(tmp_path.iterdir())


def test_noise_shrinks_as_demands_grow(tiny):
    sizes = Layout.of_sizes({"robot_1": 3}, {"robot_1": 2})
    (learner,) = make_learners("independent", sizes)
    pupil = PPOLearner(learner, sizes, tiny(), "cpu")
    before = pupil.acting()["actor"]["log_std"].exp()
    pupil.scale_noise(0.25)
    after = pupil.acting()["actor"]["log_std"].exp()
    assert np.allclose(after, 0.25 * before)
