import json
from dataclasses import replace

import numpy as np
import pytest

import collaborative_gym as cg
from collaborative_gym.tasks.identity import ON_PLAYING, ON_STATE, Identity
from collaborative_gym.tasks.registry import make_task


def identity(name, *robots, **settings):
    return Identity.of(make_task(name, robots or None, **settings))


def test_an_identity_survives_json_and_knows_its_equal():
    one = identity("LiftTaskSawyers-v0")
    again = Identity.from_dict(json.loads(json.dumps(one.to_dict())))
    assert again == one == identity("LiftTaskSawyers-v0")
    assert one.differences(again) == []
    assert one.name == "LiftTaskSawyers-v0" and one.task == "Lift"
    assert one.robot_names == ("sawyer", "sawyer")


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"pot_mass": 3.0}, "pot_mass is 3.0, not None"),
        ({"target": (0.0, 0.0, 1.4)}, "target is [0.0, 0.0, 1.4], not None"),
        ({"randomization": "paper"}, "randomization.joint_noise is 0.0, not 0.12"),
        ({"max_episode_steps": 50}, "max_episode_steps is 50, not 200"),
    ],
)
def test_a_setting_that_differs_is_told(changed, sentence):
    one, other = identity("Lift", **changed), identity("Lift")
    found = one.differences(other)
    assert sentence in found
    assert all(each.split(" ")[0].split(".")[0] in changed for each in found)


def test_a_policy_of_one_action_mode_is_not_for_another():
    tools, joints = identity("Lift", action="tcp"), identity("Lift")
    sentence = "action is tcp, not joints"
    assert tools.differences(joints, ignore=ON_PLAYING) == [sentence]
    assert tools.differences(joints, ignore=ON_STATE) == [sentence]
    # What was saved before there were modes is of joint changes.
    old = joints.to_dict()
    del old["config"]["action"]
    old = Identity.from_dict(old)
    assert old.differences(joints) == []
    assert tools.differences(old) == [sentence]


def test_equal_numbers_of_other_kinds_are_equal():
    one = identity("Lift", pot_mass=3, target=np.array([0, 0, 1]))
    assert one.differences(identity("Lift", pot_mass=3.0, target=(0, 0, 1.0))) == []


def test_arms_are_told_apart_by_name_value_and_number():
    pandas, mixed = (
        identity("Poke", "panda", "panda"),
        identity("Poke", "panda", "jaco"),
    )
    assert mixed.differences(pandas) == ["robot_2 is jaco, not panda"]
    own = replace(cg.get_robot("panda"), payload=2.0)
    found = identity("Poke", own, "panda").differences(pandas)
    assert found == ["robot_1 is another arm of the name panda"]
    titled = replace(cg.get_robot("panda"), title="Ours")
    assert identity("Poke", titled, "panda").differences(pandas) == []
    alone = replace(pandas, robots={"robot_1": pandas.robots["robot_1"]})
    assert alone.differences(pandas) == ['robots is ["panda"], not ["panda", "panda"]']


def test_where_other_arms_stand_is_not_told():
    sawyers, mixed = identity("PokeTaskSawyers-v0"), identity("PokeTaskPandaSawyer-v0")
    assert sawyers.config["placements"] != mixed.config["placements"]
    found = sawyers.differences(mixed, ignore=ON_PLAYING)
    assert found == ["robot_1 is sawyer, not panda"]
    moved = identity("Poke", "sawyer", "sawyer")
    (told,) = moved.differences(sawyers, ignore=ON_PLAYING)
    assert told.startswith("placements is ")


def test_an_arm_with_another_model_file_is_another_arm(tmp_path):
    panda = cg.get_robot("panda")
    file = tmp_path / "panda.xml"
    file.write_text(panda.model_file.read_text())
    copied = replace(panda, model_file=file)
    pandas = identity("Poke", "panda", "panda")
    assert identity("Poke", copied, "panda").differences(pandas) == []
    file.write_text(
        file.read_text().replace("<worldbody>", "<!-- ours --><worldbody >")
    )
    assert identity("Poke", copied, "panda").differences(pandas) == []
    file.write_text(file.read_text().replace('mass="', 'mass="1'))
    assert identity("Poke", copied, "panda").differences(pandas)


def test_a_setting_of_a_later_version_is_not_compared():
    one = identity("Lift")
    later = replace(one, config={**one.config, "wind": 3.0})
    assert one.differences(later) == later.differences(one) == []


def test_the_name_the_task_and_versions_are_told():
    one = identity("PokeTaskSawyers-v0")
    named = replace(one, name="Poke")
    assert one.differences(named) == ["environment is PokeTaskSawyers-v0, not Poke"]
    assert one.differences(named, ignore=ON_STATE) == []
    assert one.differences(identity("Lift", "sawyer", "sawyer"), ignore=["name"]) == [
        "task is Poke, not Lift"
    ]
    old = replace(one, versions={**one.versions, "mujoco": "3.9.0"})
    (found,) = old.differences(one)
    assert found.startswith("version of mujoco is 3.9.0, not ")


def test_policies_may_be_played_on_other_starts_and_lengths():
    one = identity("Lift", randomization="paper", max_episode_steps=50)
    one = replace(one, name="Mine", versions={})
    assert one.differences(identity("Lift"), ignore=ON_PLAYING) == []
    placed = identity("LiftTaskSawyers-v0").differences(
        identity("Lift", "sawyer", "sawyer"), ignore=ON_PLAYING
    )
    assert [each.split(" ")[0] for each in placed] == [
        "placements",
        "target",
        "picking_threshold",
    ]


@pytest.mark.parametrize("content", [{}, {"name": "a"}, [], None, {"robots": 3}])
def test_what_is_no_identity_is_refused(content):
    with pytest.raises(ValueError, match="not the identity"):
        Identity.from_dict(content)
