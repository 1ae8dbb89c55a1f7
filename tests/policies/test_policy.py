import gymnasium
import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.policies import as_played, load_policy
from collaborative_gym.policies.network import NetworkPolicy, Part, Weights
from collaborative_gym.policies.policy import POLICY_FILE, SHIPPED
from collaborative_gym.tasks.identity import Identity


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


def test_what_a_style_draws_does_not_depend_on_the_number_of_worlds():
    episodes = []
    for num_envs in 1, 3:
        report = cg.evaluate(
            "PassTaskSawyers-v0", "expert:anywhere", episodes=3, num_envs=num_envs
        )
        episodes.append([row["return"] for row in report.episodes])
    assert episodes[0] == episodes[1]
    assert len(set(episodes[0])) == 3


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


def test_experts_can_be_late_and_slow(make_env):
    env = make_env(2, max_episode_steps=30)
    late, slow, usual = (
        load_policy(name, env) for name in ("expert:late", "expert:slow", "expert")
    )
    observations, _ = env.reset(seed=0)
    half, whole = slow(observations), usual(observations)
    for agent in env.agents:
        np.testing.assert_array_equal(half[agent][:, :-1], whole[agent][:, :-1] / 2)
        np.testing.assert_array_equal(half[agent][:, -1], whole[agent][:, -1])
    for step in range(25):
        expected = env.idle() if step < 20 else env.expert()
        for agent, actions in late(observations).items():
            np.testing.assert_array_equal(actions, expected[agent])
        observations = env.step(env.idle())[0]


def test_a_task_may_have_styles_of_its_own(make_env, monkeypatch):
    env = make_env(1)
    monkeypatch.setattr(type(env.task), "styles", {"still": "nothing moves"})
    monkeypatch.setattr(
        type(env.task),
        "styled",
        lambda self, sim, facts, style, draws: {
            agent: cg.Motion(np.zeros((1, 7)), grips=True) for agent in self.agents
        },
    )
    observations, _ = env.reset(seed=0)
    actions = load_policy({"robot_1": "expert:still", "robot_2": "expert"}, env)
    assert actions(observations)["robot_1"].tolist() == [[0.0] * 7 + [1.0]]
    with pytest.raises(KeyError, match=r"no expert style 'lat'.*: late, slow, still"):
        load_policy("expert:lat", env)
    with pytest.raises(TypeError, match="'expert:late' needs an environment"):
        load_policy("expert:late")


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
    env = make_env()
    with pytest.raises(KeyError, match=r"did you mean 'expert'\?\); .*idle") as caught:
        load_policy("exprt", env)
    assert "HockeyDoubles-v0" not in str(caught.value)  # It has no baseline.
    with pytest.raises(KeyError, match=r"did you mean 'PokeTaskSawyers-v0'"):
        load_policy("PokeTaskSawyer", env)


def test_a_policy_is_for_an_environment_of_this_package():
    with pytest.raises(TypeError, match=r"a VectorEnv, or a PettingZoo .*, got 3"):
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
    path = tmp_path / "run" / POLICY_FILE
    NetworkPolicy(
        parts,
        weights,
        activation="relu",
        identity=Identity.of(env.task),
        layout=env.world.definition.layout,
        metadata={},
    ).save(path)
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


def test_a_policy_for_another_environment_is_refused(saved, make_env):
    with pytest.raises(ValueError, match="for Carry with 2 panda; here height is"):
        load_policy(saved, make_env(height=0.7))
    with pytest.raises(ValueError, match="here task is Poke, not Carry"):
        cg.evaluate("PokeTaskSawyers-v0", saved.parent, episodes=1)
    load_policy(saved, make_env(height=0.7), any_env=True)
    with pytest.raises(ValueError, match="here robot_1 is panda, not sawyer"):
        cg.evaluate(cg.task("Poke", ("panda", "panda")), "PokeTaskSawyers-v0")


@pytest.mark.parametrize("batched", [False, True])
def test_policies_play_gymnasiums_environments(saved, carry_id, make_env, batched):
    policy = {"robot_1": saved, "robot_2": "random"}
    if batched:
        env = gymnasium.make_vec(
            carry_id, num_envs=2, vectorization_mode="vector_entry_point"
        )
    else:
        env = gymnasium.make(carry_id)
    act, same = load_policy(policy, env), load_policy(policy, make_env(2))
    observation, _ = env.reset(seed=0)
    action = act(observation)
    assert action.shape == env.action_space.shape
    ours = make_env(2)
    same = load_policy(policy, ours)
    actions = same(ours.reset(seed=0)[0])
    joined = np.concatenate([actions[agent] for agent in ours.agents], axis=1)
    assert np.array_equal(action, joined if batched else joined[0])
    env.step(action)


def test_the_baseline_is_the_shipped_policy(saved, carry_id, make_env, monkeypatch):
    env = make_env()
    observations, _ = env.reset(seed=0)
    monkeypatch.setitem(SHIPPED, "baseline", saved.parent)
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
    with pytest.raises(FileNotFoundError, match=f"no ego is shipped for {carry_id}"):
        load_policy("ego", env)


def test_what_is_missing_is_named(make_env, tmp_path):
    with pytest.raises(
        FileNotFoundError,
        match=r"has no policy\.safetensors; .*validation_interval.*--resume",
    ):
        load_policy(tmp_path)
    with pytest.raises(
        FileNotFoundError, match=r"no policy file runs/nowhere .*folder"
    ):
        load_policy("runs/nowhere")
    for name in ("baseline", "expert", "frozen", "gripping", "idle", "random"):
        with pytest.raises(TypeError, match=f"'{name}' needs an environment"):
            load_policy(name)
    with pytest.raises(TypeError, match="'robot_1': 'idle'} needs an environment"):
        load_policy({"robot_1": "idle"})


def play(env, policy, steps=5):
    """Return the actions of a few steps from seed 3, (steps, num_envs, columns)."""
    act = load_policy(policy, env)
    observations, _ = env.reset(seed=3)
    taken = []
    for _ in range(steps):
        actions = act(observations)
        taken.append(np.concatenate([actions[agent] for agent in env.agents], axis=1))
        observations, *_ = env.step(actions)
    return np.array(taken)


def test_one_policy_for_each_robot_is_that_policy(saved, make_env, monkeypatch):
    loads = []
    load = NetworkPolicy.load
    monkeypatch.setattr(
        NetworkPolicy, "load", lambda path: loads.append(path) or load(path)
    )
    together = play(make_env(2), saved)
    apart = play(make_env(2), {"robot_1": saved, "robot_2": str(saved)})
    assert np.array_equal(together, apart) and len(loads) == 2
    for name in ("expert", "random"):
        apart = play(make_env(2), {"robot_2": name, "robot_1": name})
        assert np.array_equal(play(make_env(2), name), apart)


def test_two_policies_play_with_each_other(saved, make_env):
    env = make_env(2)
    ours = play(env, {"robot_1": saved, "robot_2": "random"})
    one, other = load_policy(saved, env), load_policy("random", env)
    observations, _ = env.reset(seed=3)
    for actions in ours:
        by_hand = {
            "robot_1": one(observations)["robot_1"],
            "robot_2": other(observations)["robot_2"],
        }
        assert np.array_equal(np.concatenate([*by_hand.values()], axis=1), actions)
        observations, *_ = env.step(by_hand)


def test_idle_robots_hold_still_with_an_open_grip(make_env):
    actions = play(make_env(2), {"robot_1": "expert", "robot_2": "idle"})
    assert (actions[..., 8:15] == 0).all() and (actions[..., 15] == -1).all()
    assert (actions[..., :7] != 0).any()


def test_a_policy_of_one_world_asks_for_observations_alone():
    env = cg.make("PokeTaskSawyers-v0")
    policy = cg.load_policy("baseline", env)
    with pytest.raises(TypeError, match=r"alone: observations, infos = env\.reset\(\)"):
        policy(env.reset(seed=0))
    observations, _ = env.reset(seed=0)
    for given in observations["robot_1"], {"robot_1": observations["robot_1"]}:
        with pytest.raises(TypeError, match="those of robot_1, robot_2, got"):
            policy(given)


def test_a_limp_or_absent_arm_is_one_of_the_worlds(make_env, carry):
    policy = {"robot_1": "expert", "robot_2": "limp"}
    told = r"robot_2 is not limp in these worlds; make them .* limp=\(\"robot_2\",\)"
    with pytest.raises(ValueError, match=told):
        load_policy(policy, make_env(2))
    task = as_played(carry(), policy)
    assert task.config.randomization.limp == ("robot_2",)
    assert carry().config == as_played(carry(), "expert").config
    both = as_played(carry(), "absent").config.randomization
    assert both.absent == ("robot_1", "robot_2") and both.limp == ()
    limp, absent = (
        cg.evaluate(carry(), policy | {"robot_2": state}, episodes=2, num_threads=1)
        for state in ("limp", "absent")
    )
    assert limp.settings["policy"] == "robot_1=expert robot_2=limp"
    # An arm without torque has nothing at its limit.
    assert limp.strain["torque_limit_share"].worst <= 0.5 and absent.completion


def test_still_robots_grip_always_or_go_on_holding(make_env):
    env = make_env(2)
    for still, closes in {"gripping": True, "frozen": False}.items():
        policy = load_policy({"robot_1": "expert", "robot_2": still}, env)
        observations, _ = env.reset(seed=0)
        assert (policy(observations)["robot_2"][:, -1] > 0).all() == closes
    # What it holds when it freezes it goes on holding, and without moving.
    env.step(env.expert())
    assert env.scene.holds(env.sim, "robot_2").all()
    for _ in range(3):
        action = policy(observations)["robot_2"]
        assert not action[:, :-1].any() and (action[:, -1] > 0).all()
        observations, *_ = env.step(policy(observations))
    assert env.scene.holds(env.sim, "robot_2").all()
    env.step(env.idle())
    assert (policy(observations)["robot_2"][:, -1] < 0).all()


def test_a_function_may_command_one_robot(make_env):
    env = make_env(2)
    policy = {"robot_1": lambda seen: {"robot_1": np.ones((2, 8))}, "robot_2": "idle"}
    assert (play(env, policy)[..., :8] == 1).all()
    for wrong in (lambda seen: {"robot_2": np.ones((2, 8))}, lambda seen: 0):
        with pytest.raises(
            ValueError, match=r"the policy of robot_1 returned .*; it must"
        ):
            play(env, {"robot_1": wrong, "robot_2": "idle"})


def test_each_robot_needs_a_policy_that_commands_it(saved, make_env):
    env = make_env()
    with pytest.raises(ValueError, match="no policy for the agent robot_2; name one"):
        load_policy({"robot_1": "expert"}, env)
    with pytest.raises(
        KeyError, match=r"no agent 'robot_3' .*; agents: robot_1, robot_2"
    ):
        load_policy({"robot_1": "idle", "robot_2": "idle", "robot_3": "idle"}, env)
    with pytest.raises(
        TypeError, match=r"policy must be one of 'baseline', .* got None"
    ):
        load_policy({"robot_1": "idle", "robot_2": None}, env)
    alone = NetworkPolicy.load(saved).serving(["robot_1"])
    alone.save(saved)
    for policy in (saved, alone):
        with pytest.raises(ValueError, match="commands robot_1, not robot_2; name an"):
            load_policy(policy, env)
        play(env, {"robot_1": policy, "robot_2": "idle"})


@pytest.mark.parametrize("policy", [3, None, True, b"expert", ["expert"], {"expert"}])
def test_odd_kinds_of_policies_are_refused(make_env, policy):
    with pytest.raises(TypeError, match="policy must be one of 'baseline', 'ego'"):
        load_policy(policy, make_env())
