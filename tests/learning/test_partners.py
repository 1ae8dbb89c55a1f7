"""Robots that do not learn, but play a policy that is given."""

import pytest

import collaborative_gym as cg
from collaborative_gym.envs.world import World
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.casting import make_casting
from collaborative_gym.learning.collector import Collector, Job
from collaborative_gym.learning.config import FAULTS, MODES
from collaborative_gym.learning.pool import Pool, read_guests
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.team import make_learners

IDLE = {"robot_2": "idle"}


@pytest.mark.parametrize("mode", MODES)
def test_only_the_others_learn(train_tiny, mode, carry):
    result = train_tiny(mode=mode, partner=IDLE)
    policy = result.policy()
    assert policy.agents == ("robot_1",)
    report = cg.evaluate(
        carry(), {"robot_1": policy, **IDLE}, episodes=2, num_threads=1
    )
    assert len(report.episodes) == 2


def test_partners_play_their_policies_without_faults(carry, tiny):
    task, numbers = carry(), tiny(**dict.fromkeys(FAULTS, 1.0))
    sizes, given = World.of(task).definition.layout, ["robot_2=gripping"]
    casting = make_casting(task, (), given, hyperparameters=numbers)
    seats = casting.learned("")
    learners = make_learners("independent", sizes, task.sides, seats=seats)
    assert [learner.agents for learner in learners] == [("robot_1",)]
    collector = Collector(Job(task, learners, sizes, 0, numbers, 1, casting))
    learner = PPOLearner(learners[0], sizes, numbers, "cpu", casting)
    pool = Pool(casting, read_guests(task, casting, given))
    env, played = collector.env, []
    step = env.step

    def spied(actions):
        played.append(actions)
        return step(actions)

    env.step = spied
    actors, everything = {learner.learner.name: learner.acting()}, Assistance(0.0)
    everything.demand = 1.0
    invitation = pool.invitation(learner.weights)
    collector.collect(actors, 0, everything, invitation)
    assert len(played) == numbers.rollout_steps
    assert not any(actions["robot_2"][:, :-1].any() for actions in played)
    for actions in played:
        # It grips in the worlds where its hand was open, or holds already.
        assert (actions["robot_2"][:, -1] == 1.0).any()
        assert (actions["robot_1"][:, -1] == -1.0).all()
    assert played[-1]["robot_1"][:, :-1].any()


def test_a_run_goes_on_with_its_partners(train_tiny, tiny):
    result = train_tiny(partner=IDLE)
    more = {"resume": result.folder, "hyperparameters": tiny(total_steps=160)}
    again = train_tiny(**more)
    assert again.settings.partners == ("robot_2=idle",)
    assert again.policy().agents == ("robot_1",)
    with pytest.raises(ValueError, match=r"partners is \(\), not \('robot_2=idle',\)"):
        train_tiny(**more, partner={})


@pytest.mark.parametrize(
    ("partners", "message"),
    [
        ({"robot_3": "idle"}, "no agent 'robot_3'"),
        ({"robot_1": "idle", "robot_2": "idle"}, "so that nobody learns; leave one"),
        ({"robot_2": 3}, "the partner robot_2 must be a policy's name, got 3"),
        ({"robot_2": "idel"}, "partner 'robot_2=idel': no policy 'idel'"),
        (3, "partner must be a policy's name, several, or one for each of some seats"),
    ],
)
def test_wrong_partners_are_refused(train_tiny, partners, message):
    with pytest.raises((KeyError, TypeError, ValueError), match=message):
        train_tiny(partner=partners)


def test_a_large_team_has_drawn_casts_with_each_member_in_each_seat(tiny):
    task = cg.task("Reach", "panda", num_robots=5)
    casting = make_casting(
        task, (), ("population",), hyperparameters=tiny(population=3, num_envs=128)
    )
    assert len(casting.casts) == 63
    for seat in range(5):
        own = [cast[seat] for cast in casting.casts]
        assert {name: own.count(name) for name in own} == dict.fromkeys("123", 21)
    assert len(set(casting.casts)) > 40
    casting.check(128)


def test_a_small_team_has_all_casts(carry, tiny):
    numbers = tiny(population=3)
    casting = make_casting(carry(), (), ("population",), hyperparameters=numbers)
    assert len(set(casting.casts)) == len(casting.casts) == 9
