"""Starts of episodes in which nothing is inside anything else."""

import numpy as np

from collaborative_gym.control import ActionMode
from collaborative_gym.rng import EpisodeRandom
from collaborative_gym.scene.contacts import KINDS, depth_sensors
from collaborative_gym.sim.sim import Sim
from collaborative_gym.tasks.task import Task

DEEPEST, _REFUSED = 1e-4, 1e-3
"""Depth of a contact from which a start is drawn again, and from which a task that has
no other is refused, in m. What lies or is held is less than a tenth of a millimetre
deep; from a few mm on, a contact throws an arm out of what it is in."""

OVERLAP = "mm deep in one another"
"""Words of every error about such a start."""

_DRAWS = 100  # draws of a start, before an error says that there is none


def draw_starts(
    task: Task, sim: Sim, mode: ActionMode, env_ids: np.ndarray, rng: EpisodeRandom
) -> int:
    """Write starts into these worlds in which nothing is deep in anything else.

    A start is drawn again, by the same generator, if shapes that can collide are more
    than 0.1 mm deep in one another: two arms, links of one arm, loose things, or one of
    these and what is fixed. Links that touch at the arm's home never collide.

    Args:
      task: whose starts.
      sim: the worlds, with the memory of the task.
      mode: what actions mean in them.
      env_ids: which of them start an episode.
      rng: their generators, in the same order.

    Returns:
      How many starts were drawn.

    Raises:
      ValueError: if every draw of a start is so; names what is deep in what.
    """
    drawn = 0
    sensors = np.concatenate([*depth_sensors(sim.model, KINDS).values()])
    depths = sim.model.sensor_adr[sensors]
    for _ in range(_DRAWS):
        drawn += len(env_ids)
        sim.reset(env_ids)
        for name, array in task.remember(len(env_ids)).items():
            sim.memory[name][env_ids] = array
        task.start(sim, env_ids, rng=rng)
        mode.start(env_ids)
        sim.forward(env_ids)
        is_deep = sim.xp.any(sim.sensordata[:, depths] < -DEEPEST, axis=1)
        left = np.array([i for i, own in enumerate(env_ids) if is_deep[int(own)]], int)
        if not len(left):
            return drawn
        env_ids, rng = env_ids[left], rng.rows(left)
    found = [deepest(sim, env_id) for env_id in env_ids]
    (depth, told), (seed, episode) = max(zip(found, rng.keys, strict=True))
    if depth < _REFUSED:
        return drawn
    raise ValueError(
        f"{type(task).__name__}: {told} at the start of episode {episode} of seed"
        f" {seed}, in each of {_DRAWS} draws; place them apart in mounts(), build() or"
        " reset() (start_arms?), or correct the home or the shapes of an arm"
    )


def deepest(sim: Sim, env_id: int) -> tuple[float, str]:
    """Return the depth of a world's deepest contact in m, and it in words.

    Without a contact they are 0 and empty.
    """
    contacts = sim.data(env_id).contact
    if not len(contacts):
        return 0.0, ""
    contact = contacts[int(np.argmin(contacts.dist))]
    one, other = (
        f"{sim.model.body(int(sim.model.geom_bodyid[geom])).name} (geom"
        f" {sim.model.geom(geom).name or '?'})"
        for geom in contact.geom
    )
    depth = -float(contact.dist)
    return depth, f"{one} and {other} are {1000 * depth:.1f} {OVERLAP}"
