"""A task that breaks a promise is told which, and what to do about it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym import plugins
from collaborative_gym.testing import check_task


@pytest.fixture
def faults(carry):
    """Return a function that checks the small task with methods replaced."""

    def faults(config=None, **methods):
        base = type(carry())

        def wrapped(own, method):
            return lambda self, *given, **named: method(self, own, *given, **named)

        changed = {
            name: wrapped(getattr(base, name), method)
            for name, method in methods.items()
        }
        task = type("Broken", (base,), changed)
        arms = [cg.get_robot("panda")] * 2
        try:
            check_task(task(arms, config or task.config_class()), episodes=4)
        except AssertionError as error:
            return str(error).splitlines()
        return []

    return faults


@pytest.fixture
def hard(carry):
    """Return settings with which nobody succeeds."""
    return type(carry().config)(height=5.0)


def test_a_sound_task_has_no_faults(faults):
    assert faults() == []


def test_a_class_and_an_id_are_checked_too(carry, carry_id):
    for task in (type(carry()), carry_id):
        check_task(task, episodes=2)
    with pytest.raises(KeyError, match="did you mean 'Carry'"):
        check_task("Cary")


def test_without_an_expert_nothing_shows_that_the_goal_can_be_reached(carry):
    task = type("Carry", (type(carry()),), {"expert": cg.Task.expert})
    with pytest.warns(UserWarning, match=r"Carry has no expert\(\), so nothing has"):
        check_task(task, episodes=2)


def test_a_goal_that_nobody_reaches(faults, hard):
    found = faults(hard)
    assert found[0] == "Broken fails check_task:"
    assert "the expert does not reach the goal in the episodes [0, 1, 2, 3]" in found[1]
    assert "(its least shortfall in 0 is 1)" in found[1]


def test_a_goal_that_is_reached_by_doing_nothing(faults):
    found = faults(success=lambda self, own, facts: facts.height > -1.0)
    assert any("robots that hold still reach the goal in all" in each for each in found)


@pytest.mark.parametrize(
    ("away", "at_goal", "said"),
    [
        (1.0, 0.5, "shortfall() is 0.5 where success() is True; "),
        (1.0, -1.0, "shortfall() is -1 where success() is True; "),
        (1.0, np.nan, "shortfall() is nan where success() is True; "),
        (0.0, 0.0, "shortfall() is 0 where success() is False; "),
        (
            [[1.0]],
            [[0.0]],
            "shortfall() has shape (1, 4); it must be a number for each",
        ),
    ],
)
def test_a_shortfall_that_is_none(faults, away, at_goal, said):
    def shortfall(self, own, facts):
        return np.where(own(self, facts) > 0.0, away, at_goal)

    (found,) = faults(shortfall=shortfall)[1:]
    assert said in found and len(found) < 130
    assert "shape" in said or "at least 0, and 0 where the goal is met and" in found


def changed_observe(self, own, facts):
    facts.joints["robot_1"][:] -= 0.1
    return own(self, facts)


def changed_reward(self, own, facts, commands):
    facts.distance["robot_2"][facts.height > 0.52] += 0.1
    return own(self, facts, commands)


def changed_success(self, own, facts):
    facts.height[:] *= 0.999
    return own(self, facts)


@pytest.mark.parametrize(
    ("method", "fact"),
    [
        (changed_observe, "facts.joints['robot_1']"),
        (changed_reward, "facts.distance['robot_2']"),
        (changed_success, "facts.cube[0]"),  # of which the height is a part
    ],
)
def test_a_method_that_changes_the_facts_is_named(faults, method, fact):
    name = method.__name__.removeprefix("changed_")
    found = faults(**{name: method})
    assert f"{name}() changes {fact}; make new arrays" in " ".join(found)
    assert "measure()" not in " ".join(found)


def test_a_method_that_changes_the_worlds_is_named(faults):
    def success(self, own, facts):
        self.seen.qvel[:, -1] += 0.5
        return own(self, facts)

    def measure(self, own, sim):
        self.seen = sim
        return own(self, sim)

    found = faults(success=success, measure=measure)
    assert any("() changes sim.state; make new arrays" in each for each in found)


def test_a_count_of_measurements_near_the_goal(faults):
    def measure(self, own, sim):
        facts = own(self, sim)
        is_near = (facts.height > 0.52)[:, None]
        sim.memory["push"] = sim.memory["push"] + is_near
        return facts

    found = faults(measure=measure)
    assert any("the same state (sim.memory['push']); write" in each for each in found)


def test_a_gain_since_the_last_measurement(faults):
    """A second time it is none, and a third, so that these two agree."""

    def measure(self, own, sim):
        facts = own(self, sim)
        gain = facts.height - sim.memory["push"][:, 0]
        sim.memory["push"] = np.stack([facts.height] * 3, axis=1)
        return replace(facts, height=gain)

    found = faults(
        measure=measure, shortfall=lambda self, own, facts: 0.0 * facts.height
    )
    assert any("the same state (facts.height); write nothing" in each for each in found)


def test_random_numbers_when_a_task_is_made(faults):
    drawn = np.random.default_rng(3)

    def build(self, own, scene):
        own(self, scene)
        scene.spec.body("cube/cube").pos[0] += drawn.uniform(0.0, 0.01)

    found = faults(build=build)
    assert any("the task plays otherwise if it is made again" in each for each in found)


def test_success_that_spreads_among_worlds_which_have_it_at_once(faults):
    def success(self, own, facts):
        met = own(self, facts)
        return np.full_like(met, met.any())

    found = faults(success=success)
    assert any("changes when the goal of another is met" in each for each in found)


def test_a_write_to_the_memory_near_the_goal(faults):
    def measure(self, own, sim):
        facts = own(self, sim)
        if (facts.height > 0.52).any():
            sim.memory["push"][:, 0] = 3.0
        return facts

    said = r"read-only; put a new array into sim.memory instead \(test_testing.py, line"
    with pytest.raises(RuntimeError, match=said):
        faults(measure=measure)


@pytest.mark.parametrize(
    ("method", "late", "said"),
    [
        ("success", lambda own: own.all(), "success() is bool of shape ()"),
        ("success", lambda own: 1.0 * own, "success() is float64 of shape (4,)"),
        ("reward", lambda own: {"robot_1": own["robot_1"]}, "no entry for robot_2"),
        (
            "reward",
            lambda own: {
                a: {n: x[:, None] for n, x in o.items()} for a, o in own.items()
            },
            "term 'distance' of robot_1 has shape (4, 1)",
        ),
        ("observe", lambda own: {"robot_1": own["robot_1"]}, "no entry for robot_2"),
        (
            "observe",
            lambda own: {a: {n: x[0] for n, x in o.items()} for a, o in own.items()},
            "block 'joints' of robot_1 has shape (7,)",
        ),
        (
            "performing",
            lambda own: np.zeros(4),
            "performing() is float64 of shape (4,)",
        ),
    ],
)
def test_what_is_of_another_kind_near_the_goal_is_named(faults, method, late, said):
    def changed(self, own, facts, *commands):
        found = own(self, facts, *commands)
        return late(found) if facts.height.max() > 0.55 else found

    with pytest.raises(RuntimeError) as raised:
        faults(**{method: changed})
    told = str(raised.value)
    assert said in told or said.replace("4", "1") in told
    assert "broadcast" not in told


def test_the_line_of_an_error_is_named_without_load_module(faults):
    def reward(self, own, facts, commands):
        if facts.height > 0.55:
            return {}
        return own(self, facts, commands)

    with pytest.raises(ValueError, match="truth value"):
        faults(reward=reward)

    def late(self, own, facts):
        return own(self, facts) if facts.height.max() < 0.55 else facts.heihgt

    with pytest.raises(RuntimeError, match=r"\(test_testing.py, line \d+, in late\)"):
        faults(success=late)


def test_a_reset_of_other_worlds(faults):
    def reset(self, own, sim, env_ids, *, rng):
        own(self, sim, env_ids, rng=rng)
        sim.memory["push"][:] = sim.memory["push"][env_ids[0]]

    found = faults(reset=reset)
    assert any("write only the rows env_ids in reset()" in each for each in found)


def test_numbers_that_are_drawn_elsewhere(faults):
    shared = np.random.default_rng(0)

    def reset(self, own, sim, env_ids, *, rng):
        own(self, sim, env_ids, rng=rng)
        sim.memory["push"][env_ids] = shared.uniform(-20.0, 20.0, (len(env_ids), 3))

    found = faults(reset=reset)
    assert "in reset() only from rng" in found[1]
    assert all(each.startswith("- perhaps by the same fault, ") for each in found[2:])
    assert len(found) > 2


def test_starts_that_are_alike(faults):
    def reset(self, own, sim, env_ids, *, rng):
        for arm in self.scene.arms.values():
            sim.qpos[env_ids, arm.qpos] = arm.robot.home

    found = faults(reset=reset)
    assert any("episodes start alike under the randomization" in each for each in found)


def test_a_start_inside_a_thing(faults):
    def at(height):
        def reset(self, own, sim, env_ids, *, rng):
            own(self, sim, env_ids, rng=rng)
            place = np.array([0.0, 0.0, height])
            self.scene.place(sim, env_ids, name="cube", position=place)

        return reset

    found = faults(reset=at(0.0295))
    assert any("0.5 mm deep in one another at the start" in each for each in found)
    with pytest.raises(
        ValueError,
        match=r"20.0 mm deep in one another at the start of episode \d of seed 0",
    ):
        faults(reset=at(0.01))


def test_starts_most_of_which_are_refused(faults):
    def reset(self, own, sim, env_ids, *, rng):
        own(self, sim, env_ids, rng=rng)
        place = np.zeros((len(env_ids), 3))
        place[:, 2] = rng.uniform(-0.2, 0.05)
        self.scene.place(sim, env_ids, name="cube", position=place)

    found = faults(reset=reset)
    assert any("starts that reset() draws are refused" in each for each in found)


def test_a_memory_that_is_kept_elsewhere(faults):
    def measure(self, own, sim):
        self.count = getattr(self, "count", 0) + 1
        facts = own(self, sim)
        object.__setattr__(facts, "highest", facts.highest + self.count)
        return facts

    found = faults(measure=measure)
    assert any("belongs in sim.memory, from remember()" in each for each in found)
    assert any("measure() returns other facts when it" in each for each in found)


def test_a_memory_that_is_written_to(faults):
    def measure(self, own, sim):
        highest = sim.memory["highest"]
        np.maximum(highest, 9.0 + sim.time, out=highest)
        return own(self, sim)

    with pytest.raises(RuntimeError, match="read-only"):
        faults(measure=measure)


@pytest.mark.parametrize(
    ("name", "wrong", "said"),
    [
        ("units", "hieght", r"units has \['hieght'\], but measure"),
        ("block_units", "jionts", "block_units has 'jionts', but no unit for 'joints'"),
    ],
)
def test_a_unit_of_nothing(carry, name, wrong, said):
    broken = type("Broken", (type(carry()),), {name: {wrong: "m"}})
    with pytest.raises(AssertionError, match=said):
        check_task(broken([cg.get_robot("panda")] * 2, carry().config), episodes=2)


def test_it_tells_how_far_it_is(carry):
    told = []
    check_task(type(carry()), episodes=1, on_progress=told.append)
    assert told == sorted(told) and told[0] == 0.0 and len(told) > 5


def test_an_observation_that_blows_up(faults):
    def observe(self, own, facts):
        blocks = own(self, facts)
        late = np.where(facts.highest > facts.height + 1e-3, np.nan, 0.0)
        return {
            agent: {**own_blocks, "late": late[:, None]}
            for agent, own_blocks in blocks.items()
        }

    with pytest.raises(
        RuntimeError, match=r"observe\(\): block 'late' of robot_1 is not finite"
    ):
        faults(observe=observe)


def test_a_reward_that_blows_up_near_the_goal(faults):
    def reward(self, own, facts, commands):
        terms = own(self, facts, commands)
        terms["robot_1"]["late"] = np.where(self.success(facts), np.nan, 0.0)
        return terms

    said = r"reward\(\): term 'late' of robot_1 is not finite"
    with pytest.raises(RuntimeError, match=said):
        faults(reward=reward)


@pytest.mark.parametrize(
    "mixed", [np.mean, np.max, lambda own: own[0], lambda own: own[-1]]
)
def test_a_reward_that_mixes_worlds_near_the_goal(faults, mixed):
    def reward(self, own, facts, commands):
        terms, met = own(self, facts, commands), self.success(facts)
        terms["robot_1"]["all"] = np.where(met, mixed(facts.height), 0.0)
        return terms

    found = faults(reward=reward)
    assert any(
        "reward() returns other numbers beside other worlds" in each for each in found
    )


def test_starts_that_depend_on_the_row(faults):
    def reset(self, own, sim, env_ids, *, rng):
        own(self, sim, env_ids, rng=rng)
        sim.memory["push"][env_ids] += np.linspace(0.0, 9.0, 20)[env_ids, None]

    found = faults(reset=reset)
    assert any("draw only from rng in reset()" in each for each in found)


def test_a_thing_that_starts_on_nothing(carry):
    settings = type(carry().config)(max_episode_steps=40)
    task = type("Carry", (type(carry()),), {"expert": cg.Task.expert})
    with pytest.warns(UserWarning) as told:
        check_task(task([cg.get_robot("panda")] * 2, settings), episodes=2)
    (said,) = (str(each.message) for each in told if "falls" in str(each.message))
    assert said.startswith("'cube' falls 0.46 m while robots hold still; should it")


@pytest.mark.parametrize("kind", [LookupError, AssertionError])
def test_an_error_of_the_task_is_named_with_its_line(faults, monkeypatch, kind):
    def success(self, own, facts):
        if facts.height.max() > 0.52:
            raise kind("late")
        return own(self, facts)

    monkeypatch.setattr(plugins, "_tried", {Path(__file__)})
    where = r"\(test_testing.py, line \d+, in success\)"
    with pytest.raises(RuntimeError, match=f"{kind.__name__} in a check: late {where}"):
        faults(success=success)


def test_a_reward_of_the_wrong_sign(carry):
    base = type(carry())

    def reward(self, facts, commands):
        return {
            agent: {name: -rows for name, rows in terms.items()}
            for agent, terms in base.reward(self, facts, commands).items()
        }

    task = type("Carry", (base,), {"reward": reward})
    with pytest.warns(UserWarning, match="earns less than robots that hold still; has"):
        check_task(task, episodes=2)


def test_a_phase_of_the_expert_that_is_kept_on_the_task(faults):
    def expert(self, own, sim, facts):
        self.step = getattr(self, "step", 0) + 1
        return own(self, sim, facts)

    found = faults(expert=expert)
    assert any("keeps ['step'] on itself; put that into sim.memory" in x for x in found)


def test_a_number_that_the_reward_keeps_on_the_task_is_named_first(faults):
    def reward(self, own, facts, commands):
        before = getattr(self, "before", 0.0)
        self.before = float(facts.height.mean())
        terms = own(self, facts, commands)
        return {who: {**t, "more": facts.height - before} for who, t in terms.items()}

    found = faults(reward=reward)
    assert "keeps ['before'] on itself; put that into sim.memory" in found[1]
    assert all(each.startswith("- perhaps by the same fault, ") for each in found[2:])


def test_grips_that_are_promised_and_not_added(carry):
    class Empty(type(carry())):
        def build(self, scene):
            super().build(scene)
            scene.grips.clear()

    said = "adds no grips, but Empty.gripping is True; set `gripping = False`"
    with pytest.raises(ValueError, match=said):
        check_task(Empty(tuple(carry().robots.values()), carry().config), episodes=2)


def test_a_reward_whose_terms_change(faults):
    def reward(self, own, facts, commands):
        terms = own(self, facts, commands)
        if np.any(commands["robot_1"].moves > 0):
            terms["robot_1"] = {"all": sum(terms["robot_1"].values())}
        return terms

    with pytest.raises(RuntimeError, match="ValueError in a check") as raised:
        faults(reward=reward)
    assert "return every term at every step" in str(raised.value)


def test_a_term_that_appears_late(faults):
    def reward(self, own, facts, commands):
        terms = own(self, facts, commands)
        if facts.highest.max() > 0.55:
            terms["robot_2"]["late"] = facts.height
        return terms

    with pytest.raises(RuntimeError, match="fails check_task") as raised:
        faults(reward=reward, success=lambda self, own, facts: facts.height > -1.0)
    told = str(raised.value)
    assert "'late') for robot_2, but ('distance', 'height', 'effort') at first" in told
    assert "return every term at every step, zero where it does not count" in told
    assert "robots that hold still reach the goal" in told


def test_things_may_move_at_the_start_but_not_arms(faults):
    def moving(of):
        def reset(self, own, sim, env_ids, *, rng):
            own(self, sim, env_ids, rng=rng)
            dof = slice(-6, -3) if of == "cube" else self.scene.arms["robot_1"].dof
            sim.qvel[env_ids, dof] = 0.1

        return reset

    assert not any(
        "moves at the start" in each for each in faults(reset=moving("cube"))
    )
    found = faults(reset=moving("arm"))
    assert any("robot_1 moves at the start of an episode" in each for each in found)


def test_opponents_keep_promises_too(carry):
    def success(self, facts):
        return facts.height > 0.6, facts.height > 0.65

    def reward(self, facts, commands):
        return {
            "robot_1": {"height": facts.height},
            "robot_2": {"height": -facts.height},
        }

    parts = {
        "sides": (("robot_1",), ("robot_2",)),
        "success": success,
        "reward": reward,
        "over": lambda self, facts: facts.height > 0.7,
        "score": lambda self, facts: (facts.height, -facts.height),
    }
    task = type("Duel", (type(carry()),), parts)
    check_task(task, episodes=3)
    steps = iter(range(10**6))
    parts["score"] = lambda self, facts: (facts.height + next(steps), facts.height)
    task = type("Duel", (type(carry()),), parts)
    with pytest.raises(AssertionError, match=r"score\(\) returns another value when"):
        check_task(task, episodes=3)


def test_an_expert_that_acts_otherwise_in_another_batch(faults):
    def expert(self, own, sim, facts):
        pace, motions = 0.9**sim.num_envs, own(self, sim, facts)
        return {a: replace(m, change=m.change * pace) for a, m in motions.items()}

    found = faults(expert=expert)
    assert any("expert() returns other numbers beside other worlds" in x for x in found)


def test_a_definition_that_makes_no_world_says_so_itself(faults):
    with pytest.raises(ValueError, match=r"Broken.success\(\) is float64"):
        faults(success=lambda self, own, facts: facts.height)
