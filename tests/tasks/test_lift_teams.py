"""Lift with three arms and more."""

from dataclasses import replace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.motion.team_mass import greatest_weight
from collaborative_gym.objects.pot import handle_places, ring_pot
from collaborative_gym.scene import Scene
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.tasks.teams import alike

MIXED = ("jaco", "panda", "sawyer", "jaco", "panda")


@pytest.fixture(scope="module")
def env():
    env = cg.VectorEnv(make_task("LiftPandas3-v0"), 6, num_threads=1)
    yield env
    env.close()


def play(env, still=None, steps=60):
    """Return completion of the expert, and where all held; one may stop as it holds."""
    env.reset(seed=1)
    all_held = np.zeros(env.num_envs, bool)
    for _ in range(steps):
        actions = env.expert()
        all_held |= np.all(list(env.facts.gripping.values()), axis=0)
        if still:
            held = env.scene.holds(env.sim, still)
            rest = env.idle({still: held})[still]
            actions[still] = np.where(held[:, None], rest, actions[still])
        metrics = env.step(actions)[4]["metrics"]
    return metrics["completion"], all_held


@pytest.mark.parametrize("robots", (("panda",) * 3, MIXED))
def test_expert_lifts_with_all_arms_and_never_with_one_that_only_holds(robots):
    task = make_task("Lift", robots, max_episode_steps=60)
    env = cg.VectorEnv(task, 4, num_threads=1)
    assert play(env)[0].all()
    for agent in (env.agents[0], env.agents[-1]):
        completion, all_held = play(env, still=agent)
        assert all_held.all() and not completion.any()


@pytest.mark.parametrize("style", ("first-leads", "second-leads"))
def test_one_arm_may_lead(env, style):
    env.reset(seed=0)
    for _ in range(80):
        metrics = env.step(env.expert(style))[4]["metrics"]
    assert metrics["completion"].all()


def test_expert_lifts_after_a_mishap_in_which_one_arm_has_missed(env):
    task = make_task("LiftPandas4-v0", randomization="lost")
    env = cg.VectorEnv(task, 6, num_threads=1)
    env.reset(seed=0)
    held = np.stack(list(env.facts.gripping.values()))
    assert (held.sum(axis=0) == 3).all()
    for agent, far in env.facts.to_handle.items():
        gripping = env.facts.gripping[agent]
        assert far[gripping].max(initial=0.0) < 1e-3
        assert far[~gripping].min(initial=1.0) > task.config.picking_threshold
    for _ in range(80):
        metrics = env.step(env.expert())[4]["metrics"]
    assert metrics["completion"].all()


@pytest.mark.parametrize(
    ("count", "missing", "most"), ((3, 1, 0.0), (4, 1, 2.0), (6, 1, 4.0), (6, 0, 6.0))
)
def test_equal_arms_carry_level_what_the_others_balance(count, missing, most):
    spots = handle_places(count)[missing:, :2]
    for presses in (False, True):
        found = greatest_weight(np.ones(len(spots)), spots, presses=presses)
        assert found == pytest.approx(most, abs=1e-9)


def test_weak_arms_bound_those_that_face_them():
    spots = handle_places(4)[:, :2]
    assert greatest_weight(np.array([1.0, 1.0, 1.0, 0.5]), spots) == pytest.approx(3.0)
    # About a point between the third and its opposite one, in the ratio of 2 to 1.
    aside = spots - spots[2] / 3
    assert greatest_weight(np.array([0.5, 0.0, 1.0, 0.0]), aside) == pytest.approx(1.5)


@pytest.mark.parametrize("name", ("LiftPandas4-v0", "LiftMixed3-v0", "LiftPandas8-v0"))
def test_pot_needs_each_arm_and_shares_balance(name):
    task = make_task(name)
    task.build(Scene())
    weighing, handles = task.weighing, task.handles
    assert max(weighing.fewer) <= task.pot_mass <= weighing.together
    assert task.pot_mass >= 0.6 * weighing.together - 1e-9
    assert sum(weighing.shares) == pytest.approx(1.0)
    acts = np.array(weighing.shares) @ handles[:, :2]
    assert acts == pytest.approx(np.array(weighing.centre), abs=1e-9)
    loads = np.array(weighing.shares) * task.pot_mass
    assert (loads > 0.0).all()
    assert (loads < [way.load for way in weighing.ways]).all()


def test_teams_have_a_stricter_goal_unless_told():
    pair, team = make_task("Lift"), make_task("LiftPandas3-v0")
    assert pair.config.success_radius == 0.15 and not pair.config.egocentric
    assert pair.config.success_tilt == pytest.approx(np.radians(15.0))
    assert team.config.success_radius == 0.08 and team.config.egocentric
    assert team.config.success_tilt == pytest.approx(np.radians(4.0))
    given = make_task("LiftPandas3-v0", success_radius=0.1, egocentric=False)
    assert given.config.success_radius == 0.1 and not given.config.egocentric


def test_success_needs_all_grips_and_a_level_pot(env):
    play(env, steps=40)
    facts, task = env.facts, env.task
    assert task.success(facts).all()
    lost = {**facts.gripping, "robot_3": np.zeros(6, bool)}
    for changed in (
        {"gripping": lost},
        {"tilt": np.radians(np.full(6, 4.1))},
        {"to_target": np.full(6, 0.081)},
    ):
        assert not task.success(replace(facts, **changed)).any()


def test_all_seats_and_sizes_see_alike(env):
    task = make_task("Lift", ("panda", "panda"), egocentric=True)
    others = [cg.VectorEnv(task, 1, num_threads=1)]
    others += [cg.VectorEnv(make_task("LiftPandas4-v0"), 1, num_threads=1)]
    own = env.observation_blocks["robot_1"]
    for each in (env, *others):
        for blocks in each.observation_blocks.values():
            assert blocks == own
    assert list(own)[-1] == "mates" and own["mates"].shape == (7, 4)


def test_equal_arms_of_any_team_see_the_same_of_a_start_without_noise():
    seen = []
    for name in ("LiftPandas3-v0", "LiftPandas6-v0"):
        env = cg.VectorEnv(make_task(name, randomization="paper"), 1)
        env.reset(seed=0)
        seen += env.task.observe(env.facts).values()
    for each in seen:
        for name, rows in each.items():
            own = seen[0][name]
            if name == "mates":
                rows, own = rows[rows[:, :, 0] > 0.0], own[:, 0]
            own = np.broadcast_to(own, rows.shape)
            np.testing.assert_allclose(rows, own, atol=2e-3)


def test_mates_are_seen_from_the_own_handle(env):
    env.reset(seed=0)
    facts = env.facts
    seen = env.task.observe(facts)["robot_2"]
    place = facts.handles["robot_2"][0]
    for row, mate in enumerate(("robot_3", "robot_1")):
        is_mate, grips, gap, above = seen["mates"][:, row].T
        assert (is_mate == 1.0).all() and (grips == 0.0).all()
        assert gap == pytest.approx(facts.to_handle[mate])
        assert above == pytest.approx((facts.handles[mate][0] - place)[:, 2])
    assert (seen["mates"][:, 2:] == 0.0).all()


@pytest.mark.parametrize(
    ("settings", "reason"),
    (
        ({"robots": ("panda",) * 9}, "needs 2 to 8 robots, got 9"),
        ({"target": (0.0, 0.0, 2.5)}, "cannot carry a load .*; mount it nearer"),
        ({"target": (1.5, 0.0, 1.1)}, "cannot carry a load .*; mount it nearer"),
        ({"egocentric": "yes"}, "egocentric must be"),
    ),
)
def test_teams_that_do_not_fit_are_refused(settings, reason):
    settings = {"robots": ("panda",) * 4, **settings}
    with pytest.raises((TypeError, ValueError), match=reason):
        make_task("Lift", settings.pop("robots"), **settings).build(Scene())


def test_arms_that_others_do_without_are_refused():
    places = tuple(make_task("LiftPandas8-v0").placements.values())
    robots = ("panda",) * 7 + ("jaco",)
    task = make_task("Lift", robots, placements=places)
    with pytest.raises(
        ValueError, match=r"must need all 8 arms: .* but robot_4 farther"
    ):
        task.build(Scene())


def test_ring_pot_has_its_handles_and_its_centre_of_mass_where_it_says():
    model = ring_pot(6, 12.0, balance=(0.03, -0.02)).compile()
    assert model.body("pot").mass[0] == pytest.approx(12.0)
    assert model.body("pot").ipos == pytest.approx([0.03, -0.02, 0.0])
    sites = np.array([model.site(f"handle_{i + 1}").pos for i in range(6)])
    assert sites == pytest.approx(handle_places(6))
    assert sites[0] == pytest.approx([0.0, -0.21 * 6 / (2 * np.pi), 0.05])


@pytest.mark.parametrize(
    "settings", ({"count": 1}, {"mass": 0.0}, {"balance": (0.1, 0.0)})
)
def test_impossible_ring_pots_are_refused(settings):
    with pytest.raises(ValueError, match=r"(count|mass|balance) must be"):
        ring_pot(**{"count": 3, "mass": 1.0, **settings})


def test_arms_of_several_kinds_have_the_same_spaces_where_they_move_their_tools():
    env = cg.make_vec("LiftMixed3-v0", 1, num_threads=1, action="tcp")
    for spaces in (env.single_observation_spaces, env.single_action_spaces):
        assert len({space.shape for space in spaces.values()}) == 1
    env.close()
    # An arm of six joints has a place for a seventh, too.
    assert alike(np.ones((2, 6))).tolist() == [[1.0] * 6 + [0.0]] * 2
    assert alike(np.ones((2, 7))).shape == (2, 7)


def test_two_arms_may_see_as_larger_teams_do():
    spaces = [
        cg.make_vec(name, 1, num_threads=1).single_observation_spaces["robot_1"].shape
        for name in ("LiftPandas2-v0", "LiftPandas3-v0")
    ]
    assert spaces[0] == spaces[1]
