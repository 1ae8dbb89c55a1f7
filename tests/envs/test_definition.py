"""A wrong definition fails when the worlds are made, and says what to change."""

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.scene import Scene


@pytest.fixture
def broken(carry, monkeypatch):
    """Return a function that makes worlds of the small task with a method replaced."""

    def broken(name, method, num_envs=3):
        task = carry()
        own = getattr(task, name)
        monkeypatch.setattr(
            task, name, lambda *given: method(task, own, *given), raising=True
        )
        return cg.VectorEnv(task, num_envs, num_threads=1)

    return broken


def every(change):
    """Return a method that changes what the task's own returns for each agent."""

    def method(task, own, *given):
        return {agent: change(dict(each)) for agent, each in own(*given).items()}

    return method


def test_a_reward_of_the_wrong_shape(broken):
    wrong = every(lambda terms: terms | {"height": terms["height"][:, None]})
    with pytest.raises(ValueError, match=r"Carry.reward.*'height' of robot_1 .*\(3,\)"):
        broken("reward", wrong)


def test_a_reward_that_is_no_number(broken):
    wrong = every(lambda terms: terms | {"height": 0.0 * terms["height"] / 0.0})
    with (
        np.errstate(invalid="ignore"),
        pytest.raises(ValueError, match="term 'height' of robot_1 is not finite"),
    ):
        broken("reward", wrong)


def test_an_observation_that_is_not_finite(broken):
    wrong = every(lambda blocks: blocks | {"cube": np.log(0.0 * blocks["cube"])})
    with (
        np.errstate(divide="ignore"),
        pytest.raises(ValueError, match="block 'cube' of robot_1 is not finite at"),
    ):
        broken("observe", wrong)


def test_an_observation_without_rows(broken):
    wrong = every(lambda blocks: blocks | {"highest": blocks["highest"][:, 0]})
    with pytest.raises(ValueError, match=r"block 'highest' .*\(3, k\).*\[:, None\]"):
        broken("observe", wrong)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda rows: rows[:1],
            r"'cube' of robot_1 has shape \(1, 3\); it needs a row",
        ),
        (lambda rows: rows.astype(object), "of type object; it must be an array of"),
        (lambda rows: rows.astype(complex), "of type complex128; it must be an array"),
        (lambda rows: rows.tolist(), "of type list; it must be an array of"),
    ],
)
def test_an_observation_of_what_is_no_number(broken, change, message):
    wrong = every(lambda blocks: blocks | {"cube": change(blocks["cube"])})
    with pytest.raises(ValueError, match=message):
        broken("observe", wrong)


def test_an_agent_that_is_forgotten_or_unknown(broken):
    def without(task, own, *given):
        return {"robot_1": own(*given)["robot_1"]}

    def misspelt(task, own, *given):
        return own(*given) | {"robot_3": {}}

    with pytest.raises(ValueError, match=r"reward\(\) has no entry for robot_2"):
        broken("reward", without)
    with pytest.raises(ValueError, match=r"observe\(\): no agent 'robot_3' .*; agents"):
        broken("observe", misspelt)
    with pytest.raises(ValueError, match="returns a list"):
        broken("observe", lambda task, own, *given: [own(*given)])
    with pytest.raises(ValueError, match="entry of robot_1 is an empty dictionary"):
        broken("reward", every(lambda terms: {}))
    with pytest.raises(ValueError, match=r"of type ndarray of shape \(3,\); it must"):
        broken("reward", every(lambda terms: terms["height"]))


@pytest.mark.parametrize("method", ["build", "reset", "measure", "observe", "reward"])
def test_a_method_that_is_not_written(carry, monkeypatch, method):
    task = carry()
    monkeypatch.delattr(type(task), method)
    with pytest.raises(NotImplementedError, match=rf"Carry has no {method}\(\); write"):
        cg.VectorEnv(task, 1)


def test_a_method_with_a_slip_in_its_name(carry, monkeypatch):
    kind = type(carry())
    monkeypatch.setattr(kind, "sucess", kind.success, raising=False)
    monkeypatch.delattr(kind, "success")
    with pytest.raises(
        NotImplementedError, match=r"no success\(\) \(or is 'sucess' it"
    ):
        cg.VectorEnv(carry(), 1, num_threads=1)


def nothing(*_):
    return None


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("units", ["height"], "must be a dictionary of a str for each name, got"),
        ("units", {"height": 3}, "must be a dictionary of a str for each name, got"),
        ("block_units", "joints", "must be a dictionary of a str for each name"),
        ("styles", ["late"], "must be a dictionary of a str for each name"),
        ("styles", {"late": "It waits."}, r"has styles, but no styled\(\); write one"),
        ("coordination", ("height",), "must be a dictionary of a str for each name"),
        (
            "coordination",
            {"height": "max"},
            r"\['height'\] must be one of .*'greatest'",
        ),
        ("progress_name", "height", "is 'height', which is not in its coord.*: none"),
        ("success_after", 0.5, "must be an integer, got 0.5"),
        ("success_for", "5", "must be an integer, got '5'"),
        ("success_for", 0, "must be at least 1, got 0"),
        ("performance_from_start", 1, "must be True or False, got 1"),
        ("gripping", "yes", "must be True or False, got 'yes'"),
        ("randomizations", {}, "has no 'default'; add one"),
        ("randomizations", {"default": 3}, "must be a dictionary of a Randomization"),
        ("robot_counts", 2, r"must be counts of robots, such as \(2,\), got 2"),
        ("robot_counts", ("2",), "must be an integer, got '2'"),
        ("robot_counts", (), "must be at least 1, got 0"),
        ("success", 0.05, "must be a method, got 0.05"),
        ("sides", nothing, "is a method; write @property above it"),
        ("max_episode_steps", 50, "is a setting; make it a field of config_class"),
        (
            "max_episode_step",
            50,
            "is no name of Task; write max_episode_steps, or _max",
        ),
        ("succes_after", 5, "is no name of Task; write success_after"),
        ("robot_count", (2,), "is no name of Task; write robot_counts"),
        ("block_unit", {}, "is no name of Task; write block_units"),
        ("disturbe", nothing, "is no name of Task; write disturb, or _disturbe for"),
        ("shortfal", nothing, "is no name of Task; write shortfall"),
        ("performin", nothing, "is no name of Task; write performing"),
        ("mishapp", nothing, "is no name of Task; write mishap"),
        ("sucess", nothing, "is no name of Task; write success"),
        (
            "measure",
            lambda self: 0,
            r"has the arguments \(self\), but is .*\(self, sim\)",
        ),
        ("start", lambda self: 0, r"called with \(self, sim, env_ids, \*, rng\)"),
        (
            "reset",
            lambda self, sim, env_ids: 0,
            r"but is called with \(self, sim, env_ids, \*, rng\)",
        ),
    ],
)
def test_a_declaration_that_means_nothing(carry, name, value, message):
    wrong = type("Wrong", (type(carry()),), {name: value})
    with pytest.raises(
        (TypeError, ValueError), match=rf"Wrong\W?.*{message}"
    ) as raised:
        cg.VectorEnv(wrong([cg.get_robot("panda")] * 2, carry().config), 1)
    assert name in str(raised.value)


def test_names_of_its_own_are_a_tasks_own_affair(carry):
    own = {"joint": nothing, "hover": nothing, "_disturbe": nothing, "height_m": 0.5}
    task = type("Mine", (type(carry()),), own)
    cg.VectorEnv(task([cg.get_robot("panda")] * 2, carry().config), 1).close()


def test_a_declaration_is_refused_where_it_is_registered_with_its_line(tmp_path):
    path = tmp_path / "slip.py"
    path.write_text(
        "import collaborative_gym as cg\n\n\nclass Slip(cg.Task):\n"
        "    robot_count = 2\n\n\ncg.register_task('Slip', Slip)\n"
    )
    with pytest.raises(TypeError, match=r"Slip.robot_count .* \(slip.py, line 5\)$"):
        cg.load_module(str(path))


@pytest.mark.parametrize(
    ("memory", "message"),
    [
        (
            lambda n: None,
            r"remember\(\) is of type NoneType; it must give arrays by name",
        ),
        (lambda n: [np.zeros(n)], r"remember\(\) is of type list; it must give arrays"),
        (lambda n: {"a": 0.0}, r"remember\(\): 'a' is of type float for 1 world"),
        (
            lambda n: {"a": np.zeros(3)},
            r"'a' is of type ndarray of shape \(3,\) for 1 w",
        ),
        (
            lambda n: {"highest": np.zeros(n, int), "push": np.zeros((n, 3))},
            r"makes sim.memory\['highest'\] float64 \(3,\), which was int64",
        ),
        (
            lambda n: {"highest": np.zeros((n, 1)), "push": np.zeros((n, 3))},
            r"\['highest'\] float64 \(3, 3\), which was float64 \(3, 1\)",
        ),
    ],
)
def test_a_memory_that_is_none(carry, memory, message):
    wrong = type("Wrong", (type(carry()),), {"remember": lambda self, n: memory(n)})
    with pytest.raises(ValueError, match=rf"Wrong\..*{message}"):
        cg.VectorEnv(wrong([cg.get_robot("panda")] * 2, carry().config), 1)


@pytest.mark.parametrize(("scale", "said"), [(-1.0, "is -0.487"), (9.0, "is 4.38")])
def test_coordination_that_is_no_share(carry, scale, said):
    base = type(carry())

    def measure(self, sim):
        facts = base.measure(self, sim)
        object.__setattr__(facts, "highest", scale * facts.height)
        return facts

    parts = {"measure": measure, "coordination": {"highest": "mean"}}
    wrong = type("Wrong", (base,), parts)
    with pytest.raises(
        ValueError, match=f"coordination: highest {said}; it must be at"
    ):
        cg.VectorEnv(wrong([cg.get_robot("panda")] * 2, carry().config), 1)


@pytest.mark.parametrize(
    "mounts", [None, {"robot_1": 3}, [(0, 0, 0), (0, 1, 0)]], ids=str
)
def test_mounts_that_are_no_placements(carry, mounts):
    wrong = type("Wrong", (type(carry()),), {"mounts": lambda self: mounts})
    with pytest.raises(
        TypeError, match=r"what Wrong.mounts\(\) returns must be a|a Plac"
    ):
        cg.VectorEnv(wrong([cg.get_robot("panda")] * 2, carry().config), 1)


def test_grips_that_no_action_closes(carry, monkeypatch):
    monkeypatch.setattr(type(carry()), "gripping", False)
    with pytest.raises(
        ValueError, match=r"Carry.build\(\) adds grips.*gripping = True"
    ):
        cg.VectorEnv(carry(), 1, num_threads=1)


def test_a_goal_that_is_no_bool(broken):
    with pytest.raises(ValueError, match=r"Carry.success\(\) is float64"):
        broken("success", lambda task, own, facts: facts.height)


@pytest.mark.parametrize("y", [-1.2, -2.5])
def test_a_target_out_of_reach(broken, y):
    def build(task, own, scene):
        own(scene)
        scene.add_target("goal", 0.05)
        scene.spec.body("goal").pos = 0.0, y, 0.5

    if y > -2.0:
        broken("build", build).close()
        return
    message = r"'goal' at \[.*\] is out of every arm's reach \(robot_1's by 0\.\d+ m"
    with pytest.raises(ValueError, match=message):
        broken("build", build)


def test_an_object_whose_place_is_in_mm(carry, monkeypatch):
    own = type(carry()).reset

    def reset(task, sim, env_ids, *, rng):
        own(task, sim, env_ids, rng=rng)
        name = next(iter(task.scene.objects(sim)))
        task.scene.place(sim, env_ids, name=name, position=(700.0, 0.0, 660.0))

    monkeypatch.setattr(type(carry()), "reset", reset)
    with pytest.raises(ValueError, match="is 700 m away; give m, not mm"):
        cg.VectorEnv(carry(), 1, num_threads=1)


def test_a_target_whose_place_is_in_mm_also_beside_tools(monkeypatch):
    task = cg.task("PokeTaskSawyers-v0")
    monkeypatch.setattr(
        Scene, "targets", lambda self, sim: {"goal": np.array([[0.0, 600.0, 900.0]])}
    )
    with pytest.raises(ValueError, match="'goal' is 900 m away; give m, not mm"):
        cg.VectorEnv(task, 1, num_threads=1)


def test_facts_that_are_none_and_a_setup_that_forgets(carry, monkeypatch):
    base = type(carry())
    arms, settings = [cg.get_robot("panda")] * 2, carry().config
    empty = type("Empty", (base,), {"measure": lambda self, sim: None})
    with pytest.raises(ValueError, match=r"Empty.measure\(\) returns nothing"):
        cg.VectorEnv(empty(arms, settings), 1, num_threads=1)
    setup = {"setup": lambda self, scene, sim, *, action_mode: None}
    hasty = type("Hasty", (base,), setup)
    with pytest.raises(ValueError, match=r"Hasty.setup\(\) must call super\(\).setup"):
        cg.VectorEnv(hasty(arms, settings), 1, num_threads=1)
    bare = type("Bare", (base,), {"__init__": lambda self, robots, config: None})
    with pytest.raises(ValueError, match=r"Bare's __init__\(\) must call super\(\)'s"):
        cg.VectorEnv(bare(arms, settings), 1, num_threads=1)


def test_blocks_that_change_places_later(carry):
    base = type(carry())

    def observe(self, facts):
        found = base.observe(self, facts)
        turn = facts.height.max() > 0.52
        return {
            a: dict(reversed(own.items())) if turn else own for a, own in found.items()
        }

    task = type("Late", (base,), {"observe": observe})
    env = cg.VectorEnv(task([cg.get_robot("panda")] * 2, carry().config), 2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"Late.observe\(\) has new blocks"):
        for _ in range(10):
            env.step(env.expert())


def test_memory_of_another_name(carry, monkeypatch):
    base = type(carry())

    def measure(self, sim):
        sim.memory["hihgest"] = 1.0 * sim.time
        return base.measure(self, sim)

    wrong = type("Wrong", (base,), {"measure": measure})
    said = r"Wrong: measure\(\) and remember\(\) differ in \['hihgest'\]"
    with pytest.raises(ValueError, match=said):
        cg.VectorEnv(wrong([cg.get_robot("panda")] * 2, carry().config), 1)


@pytest.mark.parametrize("method", ["reward", "observe"])
def test_what_is_not_finite_later_is_refused_in_its_step(carry, method):
    base = type(carry())

    def late(self, facts, *commands):
        found = getattr(base, method)(self, facts, *commands)
        rows = found["robot_2"]["distance"]
        found["robot_2"]["distance"] = np.where(facts.height.max() > 0.52, np.nan, rows)
        return found

    task = type("Late", (base,), {method: late})
    env = cg.VectorEnv(task([cg.get_robot("panda")] * 2, carry().config), 2)
    env.reset(seed=0)
    said = rf"Late.{method}\(\): (block|term) 'distance' of robot_2 is not finite"
    with pytest.raises(ValueError, match=said):
        for _ in range(10):
            env.step(env.expert())


@pytest.mark.parametrize(
    ("method", "late", "said"),
    [
        (
            "reward",
            lambda own: {"robot_1": own["robot_1"]},
            "no entry for robot_2; add",
        ),
        (
            "success",
            lambda own: 1.0 * own,
            r"is float64 of shape \(2,\); it needs a bool",
        ),
        (
            "reward",
            lambda own: {
                a: {n: x[:, None] for n, x in o.items()} for a, o in own.items()
            },
            r"term 'distance' of robot_1 has shape \(2, 1\); it needs one number",
        ),
    ],
)
def test_what_is_of_another_kind_later_is_refused_in_its_step(
    carry, method, late, said
):
    base = type(carry())

    def changed(self, facts, *commands):
        found = getattr(base, method)(self, facts, *commands)
        return late(found) if facts.height.max() > 0.52 else found

    task = type("Late", (base,), {method: changed})
    env = cg.VectorEnv(task([cg.get_robot("panda")] * 2, carry().config), 2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=rf"Late.{method}\(\).*{said}"):
        for _ in range(10):
            env.step(env.expert())


def test_trying_out_leaves_the_worlds_as_new(make_env):
    env = make_env(4)
    assert not env.sim.memory["push"].any()
    np.testing.assert_array_equal(env.sim.qpos[0], env.sim.qpos[3])
    assert not env.sim.xfrc_applied.any()
