import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.policies import load_policy
from collaborative_gym.policies import policy as policy_module
from collaborative_gym.policies.network import NetworkPolicy, Part, Weights
from collaborative_gym.policies.policy import POLICY_FILE


def random_actions(env, steps):
    """Return the random policy's actions by episode and step."""
    policy = load_policy("random", env)
    observations, _ = env.reset(seed=3)
    seen = {}
    for _ in range(steps):
        progress, actions = env.progress, policy(observations)
        for i in range(env.num_envs):
            key = int(progress["episode"][i]), int(progress["step"][i])
            seen[key] = np.concatenate([actions[agent][i] for agent in env.agents])
        observations, *_ = env.step(actions)
    return seen


def test_random_actions_do_not_depend_on_the_number_of_worlds(make_env):
    alone = random_actions(make_env(1), 24)
    beside = random_actions(make_env(2), 12)
    assert set(alone) == set(beside)
    assert all(np.array_equal(alone[key], beside[key]) for key in alone)


def test_random_actions_fill_the_range_and_differ_between_steps(make_env):
    actions = np.stack(list(random_actions(make_env(4), 24).values()))
    assert actions.min() < -0.98 and actions.max() > 0.98
    assert abs(actions.mean()) < 0.05
    assert len(np.unique(actions, axis=0)) == len(actions)


def test_random_actions_differ_between_agents_and_seeds(make_env):
    env = make_env(1)
    policy = load_policy("random", env)
    drawn = []
    for seed in (0, 1):
        observations, _ = env.reset(seed=seed)
        drawn += policy(observations).values()
    assert len(np.unique(np.concatenate(drawn), axis=0)) == 4


def test_expert_is_the_tasks(make_env):
    env = make_env(2)
    observations, _ = env.reset(seed=0)
    actions, expected = load_policy("expert", env)(observations), env.expert()
    assert all(np.array_equal(actions[agent], expected[agent]) for agent in env.agents)


@pytest.mark.parametrize("name", ["expert", "random"])
def test_policies_play_a_pettingzoo_environment(carry_id, name):
    env = cg.make(carry_id)
    policy = load_policy(name, env)
    observations, _ = env.reset(seed=0)
    while env.agents:
        actions = policy(observations)
        assert all(
            env.action_space(agent).shape == action.shape
            for agent, action in actions.items()
        )
        observations, *_ = env.step(actions)


def test_unknown_policy_names_the_nearest(make_env):
    with pytest.raises(KeyError, match=r"expert, random \(did you mean 'expert'"):
        load_policy("exprt", make_env())


def test_a_policy_is_for_an_environment_of_this_package():
    with pytest.raises(TypeError, match=r"a VectorEnv or a PettingZoo .*, got 3"):
        load_policy("expert", 3)


@pytest.fixture
def saved(make_env, tmp_path):
    """Return the file of a policy that fits the small task, in a run's folder."""
    env = make_env()
    observation, action = (
        {agent: space.shape[0] for agent, space in spaces.items()}
        for spaces in (env.single_observation_spaces, env.single_action_spaces)
    )
    parts, weights = [], {}
    for i, agent in enumerate(env.agents):
        size = observation[agent]
        layer = np.full((action[agent], size), 0.01 * (i + 1), np.float32)
        bias = np.zeros(action[agent], np.float32)
        parts.append(Part((agent,), agent))
        ones = np.ones(size, np.float32)
        weights[agent] = Weights(0 * ones, ones, ((layer, bias),))
    facts = {
        "environment": "Carry",
        "robots": ["panda", "panda"],
        "observation_sizes": observation,
        "action_sizes": action,
    }
    path = tmp_path / "run" / POLICY_FILE
    NetworkPolicy(parts, weights, "relu", facts).save(path)
    return path


def test_a_policy_is_named_by_its_file_or_its_runs_folder(saved, make_env):
    env = make_env(2)
    observations, _ = env.reset(seed=0)
    expected = NetworkPolicy.load(saved)(observations)
    for name in (saved, str(saved), saved.parent, str(saved.parent)):
        for given in (None, env):
            actions = load_policy(name, given)(observations)
            assert all(np.array_equal(actions[a], expected[a]) for a in env.agents)


def test_a_trained_policy_plays_a_pettingzoo_environment(saved, carry_id):
    env = cg.make(carry_id)
    policy = load_policy(saved, env)
    observations, _ = env.reset(seed=0)
    actions = policy(observations)
    assert {agent: action.shape for agent, action in actions.items()} == {
        agent: env.action_space(agent).shape for agent in env.agents
    }
    env.step(actions)


def test_a_policy_for_other_spaces_is_refused(saved):
    env = cg.make_vec("PokeTaskSawyers-v0", 1)
    with pytest.raises(ValueError, match="for Carry with panda, panda: its observat"):
        load_policy(saved, env)
    with pytest.raises(ValueError, match="the environment's robot_1 21, robot_2 21"):
        cg.evaluate("PokeTaskSawyers-v0", saved.parent, episodes=1)


def test_the_baseline_is_the_shipped_policy(saved, carry_id, make_env, monkeypatch):
    env = make_env()
    observations, _ = env.reset(seed=0)
    monkeypatch.setattr(policy_module, "BASELINES", saved.parent)
    with pytest.raises(
        FileNotFoundError, match=f"no baseline is shipped for {carry_id}"
    ):
        load_policy(carry_id)
    saved.rename(saved.parent / f"{carry_id}.safetensors")
    one, other = load_policy(carry_id), load_policy("baseline", env)
    for agent, action in one(observations).items():
        assert np.array_equal(other(observations)[agent], action)
    mixed = make_env(robots=("panda", "jaco"))
    with pytest.raises(FileNotFoundError, match="for Carry with panda, jaco; give"):
        load_policy("baseline", mixed)


def test_what_is_missing_is_named(make_env, tmp_path):
    with pytest.raises(
        FileNotFoundError, match=r"has no policy\.safetensors; training"
    ):
        load_policy(tmp_path)
    with pytest.raises(FileNotFoundError, match="no policy file runs/nowhere"):
        load_policy("runs/nowhere")
    for name in ("baseline", "expert", "random"):
        with pytest.raises(TypeError, match=f"'{name}' needs an environment"):
            load_policy(name)
