"""Checks of a task's promises and of an arm, for whoever writes or adds one."""

import difflib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from collaborative_gym.envs.definition import Trial, plain_name
from collaborative_gym.envs.starts import DEEPEST, deepest, draw_starts
from collaborative_gym.envs.state import EnvState
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.errors import check_count, with_remedy
from collaborative_gym.plugins import location_of
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.robots import Robot, get_robot
from collaborative_gym.tasks.declared import check_class
from collaborative_gym.tasks.registry import as_task, list_tasks
from collaborative_gym.tasks.task import Task, named_facts
from collaborative_gym.trying import try_robot, unusual


def check_task(
    task: str | Task | type[Task],
    robots: Sequence[str | Robot] | None = None,
    *,
    episodes: int = 20,
    on_progress: Callable[[float], object] | None = None,
) -> None:
    """Check that a task keeps every promise that environments make.

    Every use of a task checks its definition. This also plays it, for the same bits in
    any batch, worlds that do not touch one another, saved episodes that continue, sound
    starts, a goal not reached by doing nothing, and an expert that always reaches it.

    Args:
      task: an environment id, a task's name, a task, or a task's class.
      robots: its arms, in the order of the agents; None for the environment's own, and
        for Pandas where a class is given. Only with a name or a class.
      episodes: number of the expert's episodes.
      on_progress: called with the share of the checks that are done.

    Raises:
      AssertionError: lists every broken promise and its remedy.
      KeyError: if a name is unknown.
      RuntimeError: if the task itself fails while it is played; lists that too.
      ValueError: if no world can be made of the definition.
    """
    if isinstance(task, type):
        check_class(task)
        arms = [get_robot(name) for name in robots or ("panda",) * task.robot_counts[0]]
        task, robots = task(arms, task.config_class()), None
    tested = TaskUnderTest(as_task(task, robots), check_count("episodes", episodes, 1))
    faults, errors = [], []
    try:
        tested.worlds(1)  # A definition that makes no world needs no further checks.
        for i, check in enumerate(CHECKS):
            if on_progress is not None:
                on_progress(i / len(CHECKS))
            try:
                check(tested)
            except Exception as error:
                where = location_of(error, type(tested.task))
                if any(str(error) in fault for fault in faults):
                    continue  # Several checks come upon it.
                if isinstance(error, AssertionError) and not where:
                    follows = bool(faults) and check in _MAY_FOLLOW
                    faults.append("perhaps by the same fault, " * follows + str(error))
                    continue
                errors.append(error)
                told = f"{type(error).__name__} in a check: {with_remedy(str(error))}"
                told += f" ({where})" if where else ""
                faults.append(told)
    finally:
        tested.close()
    first = f"{type(tested.task).__name__} fails check_task:"
    if errors:
        raise RuntimeError("\n- ".join([first, *faults])) from errors[0]
    if faults:
        raise AssertionError("\n- ".join([first, *faults]))


def check_robot(
    robot: str | Robot, tasks: Sequence[str] | None = None, *, episodes: int = 8
) -> None:
    """Check that two arms of a kind can do tasks, by letting the experts play.

    Every `Robot` checks its definition. If an expert fails here, the error says what
    happened, and what is unusual in the arm's definition.

    Args:
      robot: the arm, or its name.
      tasks: names of tasks; None for all.
      episodes: number of the expert's episodes in each.

    Raises:
      AssertionError: lists the tasks that fail, where and why.
      KeyError: if a name is unknown.
    """
    robot, episodes = get_robot(robot), check_count("episodes", episodes, 1)
    tried = (try_robot(robot, t, episodes)[1] for t in tasks or list_tasks())
    faults = [fault for fault in tried if fault]
    if faults:
        listed = "\n".join(f"- {fault}" for fault in [*faults, *unusual(robot)])
        raise AssertionError(f"{robot.name} does not do every task:\n{listed}")


class TaskUnderTest:
    """A task under test, batches of its worlds, and the number of episodes to play."""

    def __init__(self, task: Task, episodes: int = 20):
        self.task = task
        self.episodes = episodes
        self.at_rest = -np.inf  # the mean return of robots that hold still
        self._made: dict[tuple[int, ...], VectorEnv] = {}

    def worlds(self, num_envs: int, num_threads: int = 1, copy: int = 0) -> VectorEnv:
        """Return a batch at the start of seed 0, made once for each set of numbers."""
        key = num_envs, num_threads, copy
        if key not in self._made:
            task = self.task
            if copy:  # The task is made again, too.
                task = type(task)([*task.robots.values()], task.config)
            self._made[key] = VectorEnv(task, num_envs, num_threads=num_threads)
        self._made[key].reset(seed=0)
        return self._made[key]

    def close(self) -> None:
        """Free the worlds."""
        for env in self._made.values():
            env.close()


def play(env: VectorEnv, steps: int) -> dict[tuple[int, int], bytes]:
    """Return the bytes of each episode's observations, rewards, success and score.

    They are by seed and episode. Actions are random, by episode and step alone.
    """
    seen: dict[tuple[int, int], bytes] = {}
    for _ in range(steps):
        played = env.progress
        _, rewards, _, _, infos = env.step(_episode_actions(env))
        for i in range(env.num_envs):
            rows = [infos["final_observation"][agent][i] for agent in env.agents]
            rows += [rewards[agent][i] for agent in env.agents]
            rows += [mask[i] for mask in _met(infos)]
            rows += [points[i] for points in infos["metrics"].get("score", {}).values()]
            key = int(played["seed"][i]), int(played["episode"][i])
            given = b"".join(np.asarray(row).tobytes() for row in rows)
            seen[key] = seen.get(key, b"") + given
    return seen


def check_values(tested: TaskUnderTest) -> None:
    """Steps take what the task's methods return."""
    play(tested.worlds(7), 20)


def check_starts(tested: TaskUnderTest) -> None:
    """Episodes start apart, arms at rest within their ranges, and differ."""
    env = tested.worlds(7)
    for i in range(env.num_envs):
        depth, told = deepest(env.sim, i)
        told += f" at the start of episode {i}; place them apart in build() or reset()"
        assert depth < DEEPEST, told
    for agent, arm in env.scene.arms.items():
        low, high = arm.joint_range
        angle = env.sim.qpos[:, arm.qpos]
        said = "starts beyond its joints' ranges; in reset(), clip to arm.joint_range"
        assert (angle >= low).all() and (angle <= high).all(), f"{agent} {said}"
        said = "starts with every joint at 0; call self.start_arms() in reset()"
        assert np.asarray(angle).any(), f"{agent} {said}"
        said = "moves at the start of an episode; write no qvel of an arm in reset()"
        assert not np.asarray(env.sim.qvel[:, arm.dof]).any(), f"{agent} {said}"
    rows = np.concatenate(list(env.reset(seed=0)[0].values()), axis=1)
    assert len(np.unique(rows, axis=0)) == env.num_envs, (
        "episodes start alike under the randomization 'default'; draw places and joint"
        " angles in reset() from rng, within self.config.randomization"
    )
    env, own = tested.worlds(tested.episodes), np.arange(tested.episodes)
    rng = EpisodeRandom(0 * own, own)
    refused = draw_starts(env.task, env.sim, env.action_mode, own, rng) - len(own)
    assert refused <= len(own), (
        f"{refused} of {refused + len(own)} starts that reset() draws are refused, as"
        " one thing is inside another; draw things apart"
    )


def check_making(tested: TaskUnderTest) -> None:
    """A task that is made again has the same worlds."""
    once, again = (play(tested.worlds(7, copy=i), 4) for i in range(2))
    assert all(_agree(given, again[key]) for key, given in once.items()), (
        "the task plays otherwise if it is made again; draw no random numbers in"
        " __init__(), mounts() and build(), and in reset() only from rng"
    )


def check_batches(tested: TaskUnderTest) -> None:
    """An episode has the same bits in any batch and with any number of threads."""
    expected = play(tested.worlds(16), 4)
    for env in (tested.worlds(1), tested.worlds(7), tested.worlds(7, num_threads=4)):
        env.reset(seed=0, episodes=range(env.num_envs)[::-1])  # in other rows
        for key, given in play(env, 4).items():
            assert _agree(given, expected.get(key, b"")), (
                f"episode {key[1]} of seed {key[0]} depends on the other worlds; treat"
                " rows alike, draw only from rng in reset(), keep nothing on the task"
            )


def check_isolation(tested: TaskUnderTest) -> None:
    """Worlds that start an episode leave the others alone."""
    env, other = tested.worlds(7), tested.worlds(7, copy=1)
    late = other.get_state([1, 3])
    late.progress["step"][:] = max(0, tested.task.config.max_episode_steps - 2)
    other.set_state(late, [1, 3])
    expected, seen = play(env, 4), play(other, 4)
    for episode in (0, 2, 4, 5, 6):
        assert _agree(seen[0, episode], expected[0, episode]), (
            f"episode {episode} changes when worlds 1 and 3 start another; touch no"
            " other worlds in disturb() and measure()"
        )
    sim, others = other.sim, np.array([0, 2, 4, 5, 6])
    sim.memory = {name: array.copy() for name, array in sim.memory.items()}
    state = sim.get_state(others)
    memory = {name: array[others] for name, array in sim.memory.items()}
    begun = np.array([1, 3])
    other.task.reset(sim, begun, rng=EpisodeRandom(0 * begun, begun))
    assert np.array_equal(sim.get_state(others), state) and all(
        np.array_equal(sim.memory[name][others], rows) for name, rows in memory.items()
    ), "write only the rows env_ids in reset(), of sim and of sim.memory"


def check_saving(tested: TaskUnderTest) -> None:
    """A saved episode continues bit for bit in other worlds."""
    env, other = tested.worlds(7), tested.worlds(7, copy=1)
    play(env, 3)
    state = env.get_state([0, 5])
    expected = play(env, 4)
    other.reset(seed=1)
    play(other, 2)
    other.set_state(state, [4, 2])
    seen = play(other, 4)
    for episode in map(int, state.progress["episode"]):
        assert _agree(seen[0, episode], expected[0, episode]), (
            f"episode {episode} does not continue from its saved state; what must be"
            " remembered between steps belongs in sim.memory, from remember()"
        )


def check_measuring(tested: TaskUnderTest) -> None:
    """Methods return the same again, and change nothing; names of units are there."""
    env = tested.worlds(7)
    before, task = dict(vars(env.task)), type(env.task)
    play(env, 2)
    if task.expert is not Task.expert:
        env.expert()
    kept = [n for n, own in vars(env.task).items() if before.get(n) is not own]
    kept = [n for n in kept if type(getattr(task, n, 0)) is not cached_property]
    assert not kept, f"the task keeps {kept} on itself; put that into sim.memory"
    for _ in range(4):
        _check_methods(env)
        play(env, 2)
    named = [*named_facts(env.facts)]
    unknown = [name for name in env.task.units if name not in named]
    assert not unknown, f"units has {unknown}, but measure() returns {named}"
    # Units of other names may be for teams of another size.
    blocks = [each for own in env.observation_blocks.values() for each in own.values()]
    bare = {plain_name(block.name, env.agents) for block in blocks if not block.unit}
    for name in env.task.block_units:
        near = difflib.get_close_matches(name, bare - {name}, 1, 0.8)
        assert not near, f"block_units has {name!r}, but no unit for {near[0]!r}"


def check_goal(tested: TaskUnderTest) -> None:
    """Doing nothing does not reach the goal in every episode; warn of what falls."""
    env = tested.worlds(min(tested.episodes, 8))
    reached = np.zeros(env.num_envs, bool)
    first = {n: place.copy() for n, place in env.scene.objects(env.sim).items()}
    for step in range(tested.task.config.max_episode_steps):
        for name, place in env.scene.objects(env.sim).items() if step == 20 else ():
            if (fallen := (first[name] - place)[:, 2].max()) > _FALLEN:
                said = f"{name!r} falls {fallen:.2f} m while robots hold still"
                warnings.warn(f"{said}; should it start on something?", stacklevel=3)
        *_, infos = env.step(env.idle())
        _check_shortfall(env)
        reached |= np.logical_and.reduce(_met(infos))
    assert not reached.all(), (
        f"robots that hold still reach the goal in all of {env.num_envs} episodes; ask"
        " more in success(), or start farther from the goal"
    )
    if len(env.sides) == 1:
        tested.at_rest = infos["metrics"]["return"].mean()


def check_expert(tested: TaskUnderTest) -> None:
    """The expert, where there is one, reaches a goal from every start.

    With several sides, each from some start, while the others hold still, in the way.
    """
    if type(tested.task).expert is Task.expert:
        said = "has no expert(), so nothing has shown that its goal can be reached"
        return warnings.warn(f"{type(tested.task).__name__} {said}", stacklevel=3)
    for i, side in enumerate(tested.task.sides):
        _check_side(tested, i, side)


def _check_side(tested: TaskUnderTest, i: int, side: Sequence[str]) -> None:
    large, count = tested.worlds(tested.episodes), tested.episodes
    # Tasks that mix worlds often do so by the first or the last one.
    rows = np.arange(1, max(2, count - 1), 5) % count
    small = tested.worlds(len(rows), copy=1)
    small.set_state(large.get_state(rows))
    reached, is_divided = np.zeros(large.num_envs, bool), len(tested.task.sides) > 1
    nearest = np.full(large.num_envs, np.inf)
    for step in range(tested.task.config.max_episode_steps):
        is_same = (small.progress["episode"] == large.progress["episode"][rows]).all()
        if step % 5 == 0 or not reached.all():
            _check_methods(small)
        alone, _ = _step_of(small, small.expert(), side)
        beside, infos = _step_of(large, large.expert(), side)
        for what, own in alone.items() if is_same else ():
            alike = map(np.array_equal, own, (each[rows] for each in beside[what]))
            assert all(alike), (
                f"in step {step + 1} of the expert, {what}() returns other numbers"
                " beside other worlds; treat rows alike, and keep nothing on the task"
            )
        nearest = np.minimum(nearest, _check_shortfall(large))
        met = _met(infos)[i] & (infos["episode"] == np.arange(count))
        if met.any() and not reached.any():
            _check_apart(tested.worlds(2, copy=2), large.get_state([met.argmax()]))
        reached |= met
        if is_divided and reached.any():
            return
    never = f"the expert never reaches the goal of {', '.join(side)}, though the others"
    assert not is_divided, f"{never} hold still; fix the expert"
    failed = np.flatnonzero(~reached).tolist()
    asks = " after which success_for or success_after asks for more"
    if infos["ended"].all() and infos["metrics"]["return"].mean() < tested.at_rest:
        said = "the expert earns less than robots that hold still"
        warnings.warn(f"{said}; has a reward the wrong sign?", stacklevel=4)
    assert not failed, (
        f"the expert does not reach the goal in the episodes {failed} of seed 0 (its"
        f" least shortfall in {failed[0]} is {nearest[failed[0]]:.3g}"
        f"{asks * (not nearest[failed[0]])}); watch it by `collaborative-gym record"
        f" {tested.task.name} --only-episodes {failed[0]} --output failed.mp4`, with"
        " your --module and options, and fix the expert, or what reset() draws"
    )


def _check_apart(env: VectorEnv, reached: EnvState) -> None:
    """Check that a world whose goal is met changes nothing in one that begins."""
    env.set_state(reached, [0])
    beside = np.atleast_2d(env.task.success(env.facts))[:, 1]
    env.reset(seed=0)
    assert (beside == np.atleast_2d(env.task.success(env.facts))[:, 1]).all(), (
        "success() of a world changes when the goal of another is met; any() and all()"
        " mix worlds, so combine the agents' facts by | and &"
    )


def _check_methods(env: VectorEnv) -> None:
    """Check what the task's methods return, and change, in the present state."""
    task, sim = env.task, env.sim
    commands = env.action_mode.commands(_episode_actions(env))

    def worlds() -> dict[str, bytes]:
        now = SimpleNamespace(state=sim.get_state(), memory=sim.memory)
        return _bits(now, "sim")

    before, facts = worlds(), task.measure(sim)
    first = _bits(facts)
    changed = _changed(before, worlds()) or _changed(first, _bits(task.measure(sim)))
    again = (
        "measure() returns other facts when it is called again in the same state (%s);"
        " write nothing but sim.memory, so that a second time changes nothing, as"
        " maximum(old, new) does"
    )
    assert not changed, again % changed
    asked: dict[str, tuple[Any, ...]] = dict.fromkeys(_JUDGING, (facts,))
    asked |= {"reward": (facts, commands), "expert": (sim, facts)}
    for name, given in asked.items():
        if name == "expert" and type(task).expert is Task.expert:
            continue
        once = _bits(getattr(task, name)(*given))
        differs = _changed(once, _bits(getattr(task, name)(*given)))
        changed = _changed(first, _bits(facts)) or _changed(before, worlds())
        assert not changed, (
            f"{name}() changes {changed}; make new arrays, as a = a + b does, and new"
            " dictionaries, as d | e is"
        )
        assert not differs, (
            f"{name}() returns another value when it is called again; it must depend on"
            " its arguments alone"
        )
    changed = _changed(_bits(env.facts), first)
    assert not changed, again % changed  # The first time was in the step.
    Trial(task, sim).check(facts, commands)
    for array in sim.memory.values():
        array.flags.writeable = False  # They are kept in case the step fails.


def leaves(value: Any, name: str = "") -> dict[str, Any]:
    """Return the arrays of which a value consists, by names within it."""
    if is_dataclass(value) or isinstance(value, SimpleNamespace):
        parts = {f"{name}.{own}": part for own, part in vars(value).items()}
    elif isinstance(value, Mapping):
        parts = {f"{name}[{own!r}]": part for own, part in value.items()}
    elif isinstance(value, (tuple, list)):
        parts = {f"{name}[{i}]": part for i, part in enumerate(value)}
    else:
        return {name: value}
    found = (leaves(part, own) for own, part in parts.items())
    return {name: leaf for named in found for name, leaf in named.items()}


def _bits(value: Any, name: str = "facts") -> dict[str, bytes]:
    return {own: np.asarray(x).tobytes() for own, x in leaves(value, name).items()}


def _changed(before: dict[str, bytes], now: dict[str, bytes]) -> str:
    """Return the name of the first array that is not as before, or nothing."""
    return next((name for name in before if before[name] != now.get(name)), "")


def _step_of(
    env: VectorEnv, actions: dict[str, np.ndarray], side: Sequence[str]
) -> tuple[dict[str, list[np.ndarray]], Mapping[str, Any]]:
    """Do a side's step; return what the task's methods return, and the infos."""
    own = {agent: actions[agent] for agent in side}
    _, rewards, *_, infos = env.step(env.idle() | own)
    seen, gains = infos["final_observation"].values(), rewards.values()
    given = {"expert": actions.values(), "success": _met(infos), "observe": seen}
    given["reward"] = gains  # At last: it may follow from the others.
    return {name: list(arrays) for name, arrays in given.items()}, infos


CHECKS: tuple[Callable[[TaskUnderTest], None], ...] = (
    check_values,
    check_measuring,
    check_starts,
    check_making,
    check_batches,
    check_isolation,
    check_saving,
    check_goal,
    check_expert,
)
"""Checks of `check_task`; each raises AssertionError with a remedy."""

_JUDGING = "observe", "success", "performing", "score", "over", "shortfall"

_FALLEN = 0.3  # what a thing that is not held may fall in two seconds, in m

_MAY_FOLLOW = check_making, check_batches, check_isolation, check_saving, check_expert
"""Checks that also fail where rows are mixed or things are kept on the task."""


def _episode_actions(env: VectorEnv) -> dict[str, np.ndarray]:
    progress = env.progress
    rngs = [
        np.random.default_rng([int(episode), int(step)])
        for episode, step in zip(progress["episode"], progress["step"], strict=True)
    ]
    return {
        agent: np.stack([rng.uniform(-1.0, 1.0, space.shape) for rng in rngs])
        for agent, space in env.single_action_spaces.items()
    }


def _agree(one: bytes, other: bytes) -> bool:
    """Return whether an episode is the same as far as both have played it."""
    return one.startswith(other) or other.startswith(one)


def _check_shortfall(env: VectorEnv) -> np.ndarray | float:
    """Return how far the worlds of one side are from its goal."""
    if len(env.sides) > 1:
        return np.inf
    met: Any = env.task.success(env.facts)
    Trial(env.task, env.sim).check_masks("success", met)
    missing, worlds = np.asarray(env.task.shortfall(env.facts)), env.num_envs
    said = f"has shape {missing.shape}; it must be a number for each world, ({worlds},)"
    assert missing.shape == (worlds,), f"shortfall() {said}"
    for far, is_met in zip(missing.tolist(), met.tolist(), strict=True):
        assert 0.0 <= far < np.inf and (far == 0.0) == is_met, (
            f"shortfall() is {far:.3g} where success() is {is_met}; it must be at least"
            " 0, and 0 where the goal is met and nowhere else"
        )
    return missing


def _met(infos: Mapping[str, Any]) -> list[np.ndarray]:
    success = infos["success"]
    return list(success.values()) if isinstance(success, Mapping) else [success]
