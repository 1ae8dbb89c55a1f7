"""What part of the collecting of worlds goes into the policies of guests.

    python benchmarks/guests.py [--guests 8]

The guests are copies of the baseline, each with networks of its own.
"""

import argparse
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import torch

from collaborative_gym.envs.world import World
from collaborative_gym.learning.assistance import Assistance
from collaborative_gym.learning.casting import make_casting
from collaborative_gym.learning.collector import Collector, Job
from collaborative_gym.learning.config import recipe
from collaborative_gym.learning.pool import Pool, read_guests
from collaborative_gym.learning.ppo import PPOLearner
from collaborative_gym.learning.team import make_learners
from collaborative_gym.policies.policy import shipped_file
from collaborative_gym.tasks.registry import make_task

ENV, ROLLOUTS = "PokeTaskSawyers-v0", 2


def collector_with(names):
    """Return a collector beside these guests, its networks and its invitation."""
    task, numbers = make_task(ENV), replace(recipe(ENV), num_envs=256)
    sizes = World.of(task).definition.layout
    casting = make_casting(task, (), names, hyperparameters=numbers)
    learners = make_learners(
        "collaborative", sizes, task.sides, seats=casting.learned("")
    )
    pupils = [PPOLearner(each, sizes, numbers, "cpu", casting) for each in learners]
    pool = Pool(casting, read_guests(task, casting, names))
    actors = {each.learner.name: each.acting() for each in pupils}
    collector = Collector(Job(task, learners, sizes, 0, numbers, 1, casting))
    return collector, actors, pool.invitation(pupils[0].weights)


def main():
    """Print milliseconds of a control step, and the guests' part of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--guests", type=int, default=8)
    count = parser.parse_args().guests
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        names = [str(Path(folder, f"{i}.safetensors")) for i in range(count)]
        for name in names:
            shutil.copy(shipped_file("baseline", ENV), name)
        collector, actors, invitation = collector_with(names)
    spent, act = [], collector._guests.act

    def timed(*given):
        began = time.process_time()
        act(*given)
        spent.append(time.process_time() - began)

    collector._guests.act = timed
    collector.collect(actors, 0, Assistance(0.0), invitation)
    spent.clear()
    began = time.process_time()
    for i in range(ROLLOUTS):
        collector.collect(actors, 1 + i, Assistance(0.0), invitation)
    whole = time.process_time() - began
    steps = len(spent)
    print(f"control step of 256 worlds: {1e3 * whole / steps:.1f} ms of CPU time")
    print(f"of these, {count} guests: {1e3 * sum(spent) / steps:.1f} ms")
    print(f"share: {100 * sum(spent) / whole:.1f} %")


if __name__ == "__main__":
    main()
