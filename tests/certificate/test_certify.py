"""Tries to do a task while one arm is still."""

import json
import resource
import signal
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.certificate import certify as module
from collaborative_gym.certificate import rival
from collaborative_gym.certificate.budget import QUICK
from collaborative_gym.certificate.report import TEAM, Certificate
from collaborative_gym.certificate.search import Motions, record_actions, search
from collaborative_gym.certificate.tries import find_starts, play
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.learning.config import Hyperparameters
from collaborative_gym.learning.folder import claimed


def test_a_task_that_one_arm_can_do_is_found_out(press, small):
    budget = replace(small, rounds=8)
    certificate = cg.certify(press(together=False), budget=budget, num_threads=1)
    assert len(certificate.rows) == 6
    for trials in certificate.rows.values():
        by_player = {trial.player: trial for trial in trials}
        assert list(by_player) == ["expert", "blind", "search"]
        assert by_player["expert"].completion == 1.0
        assert by_player["search"].completed > 0
        assert min(trial.nearest for trial in trials) == 0.0
    assert max(t.completion for t in certificate.trials if t.player == "blind") > 0.2
    said = "from the start on, the others complete 12 of 12 starts (robot_1 idle, up to"
    assert said in certificate.statement


def test_a_task_that_needs_both_arms_is_not_done_by_one(press, small):
    certificate = cg.certify(press(), budget=small, num_threads=1)
    assert len(certificate.trials) == 18
    for trial in certificate.trials:
        assert trial.completed == 0 and trial.nearest > 0.0
    ways = {trial.row for trial in certificate.trials}
    assert ways == {
        (agent, *way)
        for agent in ("robot_1", "robot_2")
        for way in (("idle", 0.0), ("limp", 0.0), ("frozen", 0.5))
    }
    # An arm that froze half-way is nearer than one that never began.
    for agent in ("robot_1", "robot_2"):
        idle, frozen = (
            certificate.best[agent, *way].nearest
            for way in (("idle", 0.0), ("frozen", 0.5))
        )
        assert frozen < idle
    said = "from the start on, the others complete 0 of 12 starts (up to 22.1 %); while"
    assert said in certificate.statement


def test_a_team_that_looks_at_nothing_does_what_can_be_done_blindly(press, small):
    budget = replace(small, replays=4, rounds=8)
    certificate = cg.certify(press(), budget=budget, num_threads=1)
    assert len(certificate.trials) == 20 and len(certificate.rows) == 7
    replay, motion = (
        next(t for t in certificate.rows[TEAM] if t.player == player)
        for player in ("replay", "blind")
    )
    # Buttons are within 4 cm of where they are in another episode.
    assert replay.completion > 0.0 and motion.completion > 0.0
    assert replay.episodes == motion.episodes == small.episodes
    assert "; a team that observes nothing completes " in certificate.statement
    # The search begins with the record that is played again.
    assert motion.completed >= replay.completed
    assert replay.converged is None and motion.converged is not None
    again = cg.certify(press(), budget=replace(budget, rounds=60), num_threads=1)
    assert all(t.converged for t in again.trials if t.player in ("blind", "search"))


def test_of_many_starts_only_the_best_candidates_are_tried_on_all(press, small):
    budget = replace(small, candidates=20, rounds=2)
    task = press(together=False)
    with closing(VectorEnv(task, 30, num_threads=1, auto_reset=False)) as env:
        starts = find_starts(env, 5, 18, [0.0])[0.0]
        motions, steps = Motions(env, {"robot_2": "idle"}, budget), []
        motion, result = search(
            env,
            starts,
            np.arange(18)[None],
            motions=motions,
            budget=budget,
            rng=np.random.default_rng(1),
            on_step=steps.append,
        )
        # 20 candidates on 8 starts take 6 rounds of the 30 worlds, and 3 of them on
        # the other 10 starts one more; all on all 18 starts would take 12.
        assert sum(steps) <= 2 * 7 * 30 * (motions.steps + 10)
        cast = motions.cast(np.repeat(motion, 18, axis=0), np.zeros(18, int))
        again = play(env, starts, np.arange(18), cast, steps=motions.steps + 10)
        assert again.nearest.mean() == pytest.approx(result.nearest[0])


def test_recorded_actions_played_again_are_the_episode_itself(press):
    with closing(VectorEnv(press(), 3, num_threads=1, auto_reset=False)) as env:
        records = record_actions(env, seed=4, episodes=2)
        steps = records.shape[1]
        assert records.shape[0] == 2 and steps <= 15
        whole = env.sim.qpos[:2].copy()
        env.reset(seed=4, episodes=range(3))
        motions = Motions(env, {}, QUICK, records)
        unchanged = np.zeros((3, *motions.shape))
        policy = motions.cast(unchanged, np.array([0, 1, 1]))(np.arange(3))
        for _ in range(steps):
            env.step(policy({}))
        np.testing.assert_array_equal(env.sim.qpos[:2], whole)
        assert not np.array_equal(env.sim.qpos[1], env.sim.qpos[2])


def test_a_record_ends_with_its_episodes_where_these_end_at_the_goal():
    task = cg.task("ReachMixed3-v0")
    with closing(VectorEnv(task, 2, num_threads=1, auto_reset=False)) as env:
        steps = record_actions(env, seed=0, episodes=2).shape[1]
        assert steps == env.progress["step"].max() < task.config.max_episode_steps


def test_grips_are_closed_or_open_and_completion_is_that_of_evaluate(carry, small):
    task = carry()
    certificate = cg.certify(task, budget=QUICK, num_threads=1)
    done = {(*t.row, t.player): t.completion for t in certificate.trials}
    for passive in task.agents:
        for partner in ("idle", "gripping", "limp", "absent"):
            policy = dict.fromkeys(task.agents, "expert") | {passive: partner}
            report = cg.evaluate(task, policy, episodes=QUICK.episodes, num_threads=1)
            expected = report.completion.mean
            assert done[passive, partner, 0.0, "expert"] == expected


def test_a_run_that_was_stopped_goes_on(press, small, tmp_path):
    whole, told, shares, small = [], [], [], replace(small, rounds=1)
    expected = cg.certify(press(), budget=small, num_threads=1, on_trial=whole.append)

    def stop(trial):
        told.append(trial)
        if len(told) == 5:
            raise KeyboardInterrupt

    options = {"budget": small, "num_threads": 1, "output": tmp_path}
    with pytest.raises(KeyboardInterrupt):
        cg.certify(press(), on_trial=stop, **options)
    kept = Certificate.load(tmp_path / module.FILE)
    assert list(kept.trials) == told == whole[:5]
    certificate = cg.certify(
        press(), on_trial=told.append, on_progress=shares.append, **options
    )
    assert told == whole and certificate == expected
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert Certificate.load(tmp_path / module.FILE) == certificate
    cg.certify(press(), on_trial=stop, **options)  # Nothing is left to do.


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, "seed is 1, not 0"),
        ({"task": {"max_episode_steps": 16}}, "max_episode_steps is 16, not 15"),
        ({"rounds": 1}, "'rounds': 1"),
    ],
)
def test_another_certificate_is_not_gone_on_with(
    press, small, tmp_path, change, message
):
    task = press()
    _begin(task, small, tmp_path)
    before = (tmp_path / module.FILE).read_bytes()
    change = dict(change)
    task = press(**change.pop("task", {}))
    seed = change.pop("seed", 0)
    with pytest.raises(ValueError, match=f"another certificate: .*{message}"):
        cg.certify(task, budget=replace(small, **change), seed=seed, output=tmp_path)
    assert (tmp_path / module.FILE).read_bytes() == before


def test_one_process_at_a_time_works_in_a_folder(press, small, tmp_path):
    with (
        claimed(tmp_path),
        pytest.raises(BlockingIOError, match=f"is at work in {tmp_path}; let it end"),
    ):
        cg.certify(press(), budget=small, output=tmp_path)


def test_a_full_disk_is_told_and_leaves_what_was_there(press, small, tmp_path):
    _begin(press(), small, tmp_path)
    before = (tmp_path / module.FILE).read_bytes()
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before), limit[1]))
    try:
        with pytest.raises(OSError, match=f"cannot write {tmp_path / module.FILE}: "):
            cg.certify(press(), budget=small, output=tmp_path, num_threads=1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, ignored)
    assert (tmp_path / module.FILE).read_bytes() == before


@pytest.mark.parametrize("damage", ["cut", "format", "count", "digest", "empty"])
def test_a_damaged_certificate_is_refused(press, small, tmp_path, damage):
    file = tmp_path / module.FILE
    _begin(press(), small, tmp_path)
    content = json.loads(file.read_text())
    if damage == "format":
        content["format"] = 0
    if damage == "count":
        content["trials"][0]["completed"] += 1
    if damage == "digest":
        del content["digest"]
    text = {"cut": file.read_text()[:-9], "empty": ""}.get(damage, json.dumps(content))
    file.write_text(text)
    with pytest.raises(ValueError, match=r"certificate.json is damaged.*remove it"):
        cg.certify(press(), budget=small, output=tmp_path)
    assert file.read_text() == text


def test_a_policy_is_trained_where_others_came_nearest(
    press, small, tmp_path, monkeypatch
):
    tiny = Hyperparameters(
        num_envs=4,
        rollout_steps=8,
        epochs=1,
        minibatch_size=16,
        hidden_sizes=(8,),
        validation_episodes=2,
    )
    monkeypatch.setattr(rival, "recipe", lambda env: tiny)
    monkeypatch.setattr(module, "_TRAINING_STATES", 8)
    cheap = replace(small, rounds=1, candidates=4, episodes=4, searched_starts=0)
    options = {"num_threads": 1, "output": tmp_path}
    others = cg.certify(press(), budget=cheap, **options)
    # Trainings may be added to what was done without.
    budget = replace(cheap, ppo_steps=64, ppo_rows=1)
    certificate = cg.certify(press(), budget=budget, **options)
    assert certificate.trials[:-1] == others.trials
    trial = certificate.trials[-1]
    assert trial.player == "ppo" and trial.episodes == 4
    near = {row: min(t.nearest for t in ts) for row, ts in others.rows.items()}
    assert near[trial.row] == min(near.values())
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    policy = cg.load_policy(folder)
    assert policy.agents == tuple({"robot_1", "robot_2"} - {trial.passive})


def test_a_rival_earns_nearness_and_begins_where_it_is_told(carry):
    task = carry()
    env = cg.VectorEnv(task, 4, num_threads=1, auto_reset=False)
    env.reset()
    for _ in range(3):
        env.step(env.expert())
    states, holds = env.get_state(), env.scene.holds(env.sim, "robot_1")
    assert holds.all()
    env = cg.VectorEnv(rival.aim_at_success(task, states), 6, num_threads=1)
    env.reset()
    heights = env.facts.height
    assert set(np.round(heights, 9)) <= set(np.round(states_height(task, states), 9))
    assert env.scene.holds(env.sim, "robot_1").all()
    _, rewards, *_, infos = env.step(env.idle(grips=True))
    expected = np.where(infos["success"], 1.0, -1.0)
    assert rewards["robot_1"].tolist() == expected.tolist()


def states_height(task, states):
    """Return the cube's height in each of the states."""
    env = cg.VectorEnv(task, len(states.physics), num_threads=1)
    env.set_state(states)
    return env.facts.height


def test_what_cannot_be_certified_is_refused(press, small):
    class Alone(type(press())):
        robot_counts = (1,)

    class Divided(type(press())):
        sides = (("robot_1",), ("robot_2",))

    task = press()
    robots = list(task.robots.values())
    with pytest.raises(ValueError, match="Alone has one arm"):
        cg.certify(Alone(robots[:1], task.config), budget=small)
    with pytest.raises(ValueError, match="Divided has 2 sides"):
        cg.certify(Divided(robots, task.config), budget=small)


def test_an_expert_that_does_not_reach_the_goal_is_told(press, small):
    with pytest.raises(ValueError, match="Press: in no episode is its expert at 50%"):
        cg.certify(press(max_episode_steps=3), budget=small, num_threads=1)


def _begin(task, budget, folder):
    """Do the first trial alone."""

    def stop(trial):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cg.certify(task, budget=budget, output=folder, num_threads=1, on_trial=stop)
