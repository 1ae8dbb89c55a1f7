"""Networks for sets: mates in any order and number, the same in torch and NumPy."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import collaborative_gym as cg
from collaborative_gym.blocks import Block, Layout
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.team import make_learners
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.tasks.identity import Identity
from collaborative_gym.tasks.registry import make_task, resized
from collaborative_gym.tasks.teams import MOST_MATES, mates_block, mates_of

OWN, MATE, ROWS = 3, 4, 40
BLOCKS = {
    "joints": Block("joints", (2,)),
    "mates": Block("mates", (MOST_MATES, 1 + MATE)),
    "target": Block("target", (1,)),
}
ACTION = {"moves": Block("moves", (2,)), "grip": Block("grip", (1,))}


def layout_of(count):
    agents = [f"robot_{i + 1}" for i in range(count)]
    return Layout(dict.fromkeys(agents, BLOCKS), dict.fromkeys(agents, ACTION))


def flat(own, mates):
    """Return flat rows of own numbers (n, 3) and of mates (n, 4) each."""
    rows = mates_block(mates) if mates else np.zeros((len(own), MOST_MATES, 1 + MATE))
    parts = own[:, :2], rows.reshape(len(own), -1), own[:, 2:]
    return np.concatenate(parts, axis=1).astype(np.float32)


def drawn(count, seed=0):
    """Return observations of a team by agent."""
    rng = np.random.default_rng(seed)
    return {
        f"robot_{i + 1}": flat(
            rng.normal(size=(ROWS, OWN)) * [1.0, 20.0, 3.0],
            [5.0 + rng.normal(size=(ROWS, MATE)) for _ in range(count - 1)],
        )
        for i in range(count)
    }


@pytest.fixture
def crew(carry):
    """Return the small task of robots that see each other as mates."""

    class Crew(type(carry())):
        def observe(self, facts):
            heights = {agent: facts.tcp[agent][0][:, 2:] for agent in self.agents}
            return {
                agent: {
                    **blocks,
                    "mates": mates_block(
                        [heights[mate] for mate in mates_of(self.agents, agent)]
                    ),
                }
                for agent, blocks in super().observe(facts).items()
            }

    task = carry()
    return Crew(list(task.robots.values()), task.config)


@pytest.fixture
def learned(tiny, carry):
    """Return a function that makes a learner that has seen rows, and its policy."""

    def learned(mode="shared", count=3):
        layout = layout_of(count)
        learners = make_learners(mode, layout, network="set")
        torch.manual_seed(0)
        numbers = replace(tiny(), network="set")
        learner = PPOLearner(learners[0], layout, numbers, "cpu")
        rows = torch.from_numpy(learners[0].observations(drawn(count)))
        learner._scaler(rows, train=True)
        torch.nn.init.normal_(learner._policy.actor.nets[0].trunk[-1].weight)
        policy = NetworkPolicy(
            learners[0].parts,
            learner.weights(),
            activation=numbers.activation,
            identity=Identity.of(carry()),
            layout=layout,
            metadata={},
        )
        return learner, policy

    return learned


@pytest.mark.parametrize("mode", ["shared", "collaborative", "independent"])
def test_numpy_plays_what_torch_learned_also_from_a_file(learned, mode, tmp_path):
    learner, policy = learned(mode)
    policy.save(tmp_path / "policy.safetensors")
    read = NetworkPolicy.load(tmp_path / "policy.safetensors")
    assert read.digest == policy.digest
    observations = drawn(3, seed=1)
    state = learner.acting()
    rows = torch.from_numpy(learner.learner.observations(observations))
    seen = ((rows - state["mean"]) / state["std"]).clamp(-5.0, 5.0)
    with torch.no_grad():
        wanted = learner._policy.actor(seen).clamp(-1.0, 1.0).numpy()
    agents = learner.learner.agents
    found = read.serving(agents)({agent: observations[agent] for agent in agents})
    np.testing.assert_allclose(learner.learner.action_rows(found), wanted, atol=2e-5)
    assert np.abs(wanted).std() > 0.05


def test_the_order_of_mates_does_not_matter_but_each_of_them_does(learned):
    _, policy = learned()
    rng = np.random.default_rng(2)
    own = rng.normal(size=(ROWS, OWN))
    mates = [5.0 + rng.normal(size=(ROWS, MATE)) for _ in range(2)]

    def act(mates):
        return policy.serving(["robot_1"])({"robot_1": flat(own, mates)})["robot_1"]

    np.testing.assert_allclose(act(mates), act(mates[::-1]), atol=1e-5)
    for i in range(2):
        other = [mate + (i == j) for j, mate in enumerate(mates)]
        assert np.abs(act(mates) - act(other)).max() > 1e-2


@pytest.mark.parametrize("count", [2, 5, 8])
def test_a_shared_one_plays_in_teams_of_any_size(learned, count):
    _, policy = learned()
    agents = list(drawn(count))
    assert policy.suits_any_team
    served, observations = policy.serving(agents), drawn(count, seed=3)
    actions = served(observations)
    assert list(actions) == agents
    for agent, own in observations.items():
        alone = served.serving([agent])
        one_by_one = [alone({agent: own[i : i + 1]})[agent] for i in range(ROWS)]
        np.testing.assert_array_equal(np.concatenate(one_by_one), actions[agent])


def test_other_policies_keep_to_their_agents(learned):
    _, policy = learned("independent")
    assert not policy.suits_any_team or policy.agents == ("robot_1",)
    _, policy = learned("collaborative")
    assert not policy.suits_any_team
    with pytest.raises(ValueError, match="not robot_4"):
        policy.serving(["robot_1", "robot_4"])


def test_nobody_at_all_is_a_team_too(learned):
    _, policy = learned()
    actions = policy.serving(["robot_1"])({"robot_1": flat(np.ones((2, OWN)), [])})
    assert np.isfinite(actions["robot_1"]).all()


def test_all_mates_have_one_mean_and_deviation(learned):
    learner, _ = learned()
    observations = drawn(3)
    rows = np.concatenate(list(observations.values()))
    mates = rows[:, 2:-1].reshape(-1, MOST_MATES, 1 + MATE)
    there = mates[mates[:, :, 0] > 0.5]
    state = learner.acting()
    mean = state["mean"][2:-1].reshape(MOST_MATES, 1 + MATE).numpy()
    std = state["std"][2:-1].reshape(MOST_MATES, 1 + MATE).numpy()
    assert (mean == mean[0]).all() and (std == std[0]).all()
    assert mean[0, 0] == 0.0 and std[0, 0] == pytest.approx(1.0)
    # The first rows count against one row of zeros.
    np.testing.assert_allclose(mean[0, 1:], there[:, 1:].mean(axis=0), rtol=0.02)
    np.testing.assert_allclose(std[0, 1:], there[:, 1:].std(axis=0), rtol=0.2)


def test_critics_of_a_team_do_not_care_who_is_where(learned):
    learner, _ = learned("collaborative")
    first, *others = drawn(3, seed=4).values()
    values = [
        learner._value.compute({"observations": torch.from_numpy(rows)})[0].detach()
        for rows in (
            np.concatenate([first, *others], axis=1),
            np.concatenate([*others, first], axis=1),
        )
    ]
    assert values[0].std() > 0.1
    np.testing.assert_allclose(*values, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("mode", ["shared", "collaborative"])
def test_runs_train_go_on_and_play(mode, crew, train_tiny, tiny, tmp_path):
    numbers = replace(tiny(), network="set")
    whole = train_tiny(tmp_path / "run", mode=mode, task=crew, hyperparameters=numbers)
    part = tmp_path / "part"
    shorter = replace(numbers, total_steps=64)
    train_tiny(part, mode=mode, task=crew, hyperparameters=shorter)
    again = train_tiny(resume=part, task=crew, hyperparameters=numbers)
    assert again.policy().digest == whole.policy().digest
    assert again.policy().suits_any_team == (mode == "shared")
    report = cg.evaluate(crew, tmp_path / "run", episodes=2)
    assert np.isfinite(report.mean_reward.mean)


def test_robots_that_are_alike_share_one_by_themselves(crew, train_tiny, tiny):
    numbers = replace(tiny(), network="set", total_steps=32)
    result = train_tiny(task=crew, hyperparameters=numbers)
    assert result.policy().metadata["mode"] == "shared"
    later = replace(numbers, total_steps=64)
    more = train_tiny(
        result.folder / "more",
        task=crew,
        hyperparameters=later,
        start_from=result.folder,
    )
    assert more.policy().suits_any_team
    with pytest.raises(ValueError, match="has layers of"):
        start = {"hyperparameters": tiny(), "start_from": result.folder}
        train_tiny(result.folder / "flat", mode="shared", task=crew, **start)


def test_one_run_learns_in_teams_of_several_sizes(train_tiny, tiny, tmp_path):
    def numbers(steps):
        own = {"lost_grips": 0.0, "missed_grips": 0.0, "validation_interval": 0}
        own |= {"network": "set", "team_sizes": [2], "total_steps": steps}
        return replace(tiny(), **own, validation_episodes=1)

    task = make_task("Reach", "panda", num_robots=3, max_episode_steps=4)
    whole = train_tiny(tmp_path / "run", task=task, hyperparameters=numbers(64))
    part = tmp_path / "part"
    train_tiny(part, task=task, hyperparameters=numbers(32))
    again = train_tiny(resume=part, task=task, hyperparameters=numbers(64))
    assert again.policy().digest == whole.policy().digest
    alone = replace(numbers(64), team_sizes=())
    other = train_tiny(tmp_path / "one", task=task, hyperparameters=alone)
    assert other.policy().digest != whole.policy().digest
    own = make_task("Lift", "panda", num_robots=3).varied(max_episode_steps=7)
    team = resized(own, 2)
    assert team.config.success_radius == 0.15 and team.config.max_episode_steps == 7


@pytest.mark.parametrize(
    ("robots", "sizes", "mode", "reason"),
    [
        ("panda", (3,), "collaborative", "one policy of any team: give --network set"),
        ("panda", (9,), "shared", "Reach needs 2 to 8 robots, got 9"),
        (("panda", "sawyer"), (3,), "shared", "arms of one kind"),
    ],
)
def test_teams_of_several_sizes_that_cannot_be_are_refused(
    robots, sizes, mode, reason, train_tiny, tiny
):
    numbers = replace(tiny(), network="set", team_sizes=sizes)
    task = make_task("Reach", robots, num_robots=2 if robots == "panda" else None)
    with pytest.raises(ValueError, match=reason):
        train_tiny(task=task, mode=mode, hyperparameters=numbers)


def test_what_needs_a_set_and_has_none_is_refused(train_tiny, tiny, crew):
    plain = Layout.of_sizes({"robot_1": 3}, {"robot_1": 2})
    with pytest.raises(ValueError, match="needs observations with one set"):
        make_learners("shared", plain, network="set")
    with pytest.raises(ValueError, match="choose the mode shared"):
        make_learners("centralized", layout_of(2), network="set")
    numbers = replace(tiny(), network="set")
    with pytest.raises(ValueError, match="sac has no critics of sets"):
        train_tiny(task=crew, algorithm="sac", hyperparameters=numbers)
    with pytest.raises(KeyError, match="no network 'sets'"):
        replace(tiny(), network="sets")


def test_mates_come_in_order_round_the_team():
    agents = ["robot_1", "robot_2", "robot_3", "robot_4"]
    assert mates_of(agents, "robot_3") == ("robot_4", "robot_1", "robot_2")
