import pytest

import collaborative_gym as cg
from collaborative_gym.robots import get_robot
from collaborative_gym.viewer.menu import LINK, Choice, Menu

LIFT = "LiftTaskSawyers-v0"
SAWYERS = ("sawyer", "sawyer")


@pytest.fixture(scope="module")
def env():
    env = cg.make_vec("PokeTaskSawyers-v0", 1, num_threads=1)
    env.reset()
    return env


@pytest.fixture
def menu(env):
    return Menu(env, {"robot_1": "expert", "robot_2": "idle"})


def lift(*policies, **changes):
    return Choice(LIFT, SAWYERS, policies or ("expert", "idle"), "paper", **changes)


def test_what_plays_is_told_by_names(menu, env):
    env.reset(seed=3, episodes=[5])
    chosen = menu.chosen(env, {"robot_1": "expert", "robot_2": "idle"})
    assert chosen == Choice(
        "PokeTaskSawyers-v0", SAWYERS, ("expert", "idle"), "default", 3, 5
    )


def test_a_link_says_it_all_and_is_read_again(menu):
    choice = lift("expert:first-leads", "baseline", seed=7, episode=2)
    assert choice.link.startswith(LINK) and "?" not in choice.link
    assert menu.read(choice.link) == choice


def test_what_a_link_does_not_say_is_as_usual(menu):
    assert menu.read(f"{LINK}env={LIFT}&episode=4") == Choice(
        LIFT, SAWYERS, ("expert", "expert"), "default", 0, 4
    )
    assert menu.read(f"{LINK}env={LIFT}&policies=idle").policies == ("idle", "idle")


@pytest.mark.parametrize(
    ("link", "told"),
    [
        ("env=Nothing-v0", "no environment 'Nothing-v0'"),
        ("nonsense", "bad query field"),
        (f"env={LIFT}&robots=sawyer&robots=tank", "no robot 'tank'"),
        (f"env={LIFT}&robots=sawyer", "needs 2 to 8 robots, got 1"),
        (f"env={LIFT}&policies=idle" + 2 * "&policies=limp", "3 policies for 2 robots"),
        (f"env={LIFT}&policies=idle&policies=/etc/passwd", "no policy '/etc/passwd'"),
        (f"env={LIFT}&randomization=wild", "no randomization 'wild'"),
        (f"env={LIFT}&seed=x", "invalid literal"),
        (f"env={LIFT}&seed=-1", "seed must be at least 0"),
        (f"env={LIFT}&episode=-1", "episode must be at least 0"),
        (f"env={LIFT}&episode={2**63}", "episode must be at most"),
    ],
)
def test_a_link_to_what_may_not_be_chosen_is_refused(menu, link, told):
    with pytest.raises((KeyError, ValueError), match=told):
        menu.read(LINK + link)


def test_shipped_policies_are_offered_where_they_are_shipped(menu):
    assert {"baseline", "ego"} <= {*menu.policies(lift())}
    others = Choice(LIFT, ("panda", "jaco"), ("expert", "expert"), "default")
    assert not {"baseline", "ego"} & {*menu.policies(others)}
    jacos = menu.policies(menu.moved(lift(), "LiftTaskJacos-v0"))
    assert "baseline" in jacos and "ego" not in jacos


def test_styles_of_the_experts_are_offered(menu):
    assert {"expert:late", "expert:second-leads"} <= set(menu.policies(lift()))
    assert "expert:second-leads" not in menu.policies(
        menu.moved(lift(), "PassTaskSawyers-v0")
    )


def test_another_environment_has_its_own_arms_and_able_players(menu):
    choice = lift("expert:first-leads", "baseline")
    moved = menu.moved(choice, "PassTaskJacoSawyer-v0")
    assert moved.robots == ("sawyer", "jaco")
    assert moved.policies == ("expert", "baseline")
    doubles = menu.moved(lift("baseline", "idle"), "HockeyDoubles-v0")
    assert doubles.policies == ("expert", "idle", "expert", "expert")
    assert len(doubles.robots) == 4
    turned = menu.turned(lift("baseline", "idle"), "Pass")
    assert turned.policies == ("baseline", "expert")
    # The first environment of Sort has no baseline.
    sorting = menu.turned(lift("baseline", "baseline"), "Sort")
    assert sorting.env == "SortPandas4-v0"
    assert sorting.policies == ("baseline",) * 4


def test_another_arm_has_able_players(env):
    menu = Menu(env, {"robot_1": "baseline", "robot_2": "runs/mine"})
    assert {"baseline", "runs/mine"} <= set(menu.policies(lift()))
    choice = lift("baseline", "expert:first-leads")
    armed = menu.armed(choice, "jaco", 1)
    assert armed.robots == ("sawyer", "jaco")
    assert armed.policies == ("expert", "expert:first-leads")
    assert "baseline" not in menu.policies(armed)
    passed = menu.turned(lift("baseline", "baseline"), "Pass")
    assert passed.env == "PassTaskSawyers-v0"
    assert menu.armed(passed, "sawyer", 1).env == passed.env
    other = menu.armed(passed, "jaco", 0)
    assert other.env == "PassTaskSawyers-v0" and other.robots == ("jaco", "sawyer")
    own = menu.armed(passed, "jaco", 1)
    assert own.env == "PassTaskJacoSawyer-v0" and "baseline" in menu.policies(own)
    with pytest.raises(KeyError, match="no policy 'baseline'"):
        menu.read(armed.link.replace("policies=expert&", "policies=baseline&"))
    assert menu.armed(lift("idle", "runs/mine"), "jaco", 0).policies[1] == "expert"
    anywhere = Menu(env, {"robot_1": "expert", "robot_2": "runs/mine"}, any_env=True)
    kept = anywhere.armed(lift("idle", "runs/mine"), "jaco", 0)
    assert kept.policies == ("idle", "runs/mine")


def test_only_the_starts_that_an_environment_has_are_offered(menu):
    assert "lost" in menu.randomizations(LIFT)
    assert "lost" not in menu.randomizations("HockeyPandas-v0")
    after_mishaps = menu.drawn(lift(), "lost")
    assert menu.moved(after_mishaps, "PassTaskSawyers-v0").randomization == "lost"
    hockey = menu.moved(after_mishaps, "HockeyPandas-v0")
    assert hockey.randomization == "default"
    with pytest.raises(KeyError, match="no randomization 'lost'"):
        menu.read(hockey.link.replace("default", "lost"))


@pytest.mark.parametrize("state", ["limp", "absent"])
def test_an_arm_may_be_limp_or_absent(menu, env, state):
    chosen = menu.chosen(env, {"robot_1": "expert", "robot_2": "idle"})
    assert state in menu.policies(chosen)
    choice = menu.led(chosen, state, 1)
    other, act, policies = menu.load(choice, env)
    assert getattr(other.task.config.randomization, state) == ("robot_2",)
    observations, _ = other.reset(choice.seed, [choice.episode])
    other.step(act(observations))
    assert menu.chosen(other, policies) == choice
    back, *_ = menu.load(menu.led(choice, "idle", 1), other)
    assert back.task.config.randomization == env.task.config.randomization


def test_the_same_world_is_kept_for_other_policies_and_starts(menu, env):
    chosen = menu.chosen(env, {"robot_1": "idle", "robot_2": "idle"})
    same, act, policies = menu.load(chosen, env)
    assert same is env
    assert policies == {"robot_1": "idle", "robot_2": "idle"}
    observations, _ = env.reset(seed=0)
    assert {len(actions) for actions in act(observations).values()} == {1}
    other, *_ = menu.load(menu.moved(chosen, LIFT), env)
    assert other.task.name == LIFT


def test_what_a_viewer_was_started_with_may_be_chosen():
    def mine(observations):
        return {}

    arm = cg.get_robot("panda")
    wide = cg.Randomization(joint_noise=0.2)
    env = cg.make_vec("Poke", 1, robots=(arm, "jaco"), randomization=wide)
    env.reset()
    menu = Menu(env, dict.fromkeys(env.agents, mine))
    chosen = menu.chosen(env, dict.fromkeys(env.agents, mine))
    assert chosen == Choice("Poke", ("panda", "jaco"), ("mine", "mine"), "own")
    assert menu.load(chosen, env)[2] == {"robot_1": mine, "robot_2": mine}
    assert menu.load(chosen, env)[0] is env
    assert get_robot("panda") is arm


def test_other_arms_play_in_the_same_action_mode():
    env = cg.make_vec("PokeTaskSawyers-v0", 1, num_threads=1, action="tcp")
    menu = Menu(env, {"robot_1": "expert"})
    choice = menu.armed(
        Choice(env.task.name, SAWYERS, ("idle",) * 2, "default"), "panda", 0
    )
    other, _, _ = menu.load(choice, env)
    assert other.task.config.action == "tcp"
    assert other.task.robots["robot_1"].name == "panda"


def test_settings_go_along_to_whatever_takes_them():
    settings = {"grasp": "pinch", "wrench": "raw", "max_episode_steps": 50}
    env = cg.make_vec("PassTaskSawyers-v0", 1, num_threads=1, **settings)
    menu = Menu(env, {"robot_1": "expert"})
    choice = Choice(env.task.name, SAWYERS, ("idle",) * 2, "default")
    pinching = menu.load(menu.armed(choice, "panda", 0), env)[0].task.config
    assert {name: getattr(pinching, name) for name in settings} == settings
    config = menu.load(menu.moved(choice, "PokeTaskSawyers-v0"), env)[0].task.config
    # It has no grips.
    assert (config.grasp, config.wrench, config.max_episode_steps) == (
        "magnet",
        "raw",
        50,
    )


def test_as_many_worlds_play_after_another_choice(menu):
    env = cg.make_vec("PokeTaskSawyers-v0", 3, num_threads=1)
    env.reset(seed=2, episodes=[4, 5, 6])
    chosen = menu.chosen(env, {"robot_1": "expert", "robot_2": "idle"})
    assert (chosen.seed, chosen.episode) == (2, 4)
    other, *_ = menu.load(menu.moved(chosen, LIFT), env)
    assert other.num_envs == 3
