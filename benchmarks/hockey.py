"""How Hockey's puck bounces, and whether anything lets it through.

The first table has a puck that flies, at many phases of the physics step, against a
cushion and against the mallet of an arm that holds still: speeds after over before,
against the coefficient that was set, and how deep it was in what it hit. The second has
arms that chase the puck at full speed through all that is in their way, and pucks that
are shot at speeds that no arm gives them: the fastest puck, how deep it was in cushions
and mallets, and how often it was where it cannot have come to.

    python benchmarks/hockey.py [--worlds 64] [--steps 200]
"""

import argparse
from itertools import product

import numpy as np

import collaborative_gym as cg
from collaborative_gym.objects.mallet import RADIUS as MALLET
from collaborative_gym.objects.puck import RADIUS as PUCK
from collaborative_gym.objects.rink import HALF_LENGTH
from collaborative_gym.tasks.registry import make_task
from collaborative_gym.timing import SIM_DT, SUBSTEPS

SPEEDS = (0.2, 0.5, 1.0, 2.0, 3.0, 5.0)
SHOTS = (0.0, 3.0, 5.0, 7.0)


def put(env, place, velocity) -> None:
    """Put the pucks of all worlds at places (n, 2) with velocities (n, 2)."""
    for i, axis in enumerate("xy"):
        joint = env.model.joint(f"puck/{axis}")
        env.sim.qpos[:, joint.qposadr[0]] = place[:, i]
        env.sim.qvel[:, joint.dofadr[0]] = velocity[:, i]
    env.sim.forward()


def seen(env) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return place and velocity of the pucks, and of the mallets by agent."""
    env.sim.forward()
    mallets = [env.sim.pose(f"{agent} mallet")[0] for agent in env.agents]
    place, velocity = env.sim.pose("puck")[0], env.sim.velocity("puck")[0]
    return place[:, :2], velocity[:, :2], np.stack(mallets, axis=1)


def bounce(env, name: str, speed: float) -> tuple[np.ndarray, float]:
    """Return how fast pucks part over how fast they came, and the greatest depth in m.

    Args:
      env: worlds, each with another phase of the step.
      name: what they fly against, straight, "cushion" or "mallet".
      speed: in m/s.
    """
    env.reset(seed=0)
    count, against = env.num_envs, seen(env)[2][:, 0]
    way, touch = np.array([-1.0, 0.0]), PUCK + MALLET
    if name == "cushion":
        against[:] = 0.0, env.task.field.half_width, 0.0
        way, touch = np.array([0.0, 1.0]), PUCK
    free = 0.02 + 0.01 * speed * np.arange(count) / count
    start = against[:, :2] - (touch + free)[:, None] * way
    put(env, start, np.tile(speed * way, (count, 1)))
    gaps = [free]

    def look() -> None:
        place, _, mallets = seen(env)
        other = mallets[:, 0] if name == "mallet" else against
        gaps.append((other[:, :2] - place) @ way - touch)

    env.watch(look, shots=SUBSTEPS)
    for _ in range(2 + int(0.5 / speed)):
        env.step(env.idle())
    env.watch(None)
    # Places change by what the speed is after a step.
    speeds = np.diff(gaps, axis=0) / SIM_DT
    first, worlds = np.argmax(speeds > 0.0, axis=0), np.arange(count)
    assert (first > 0).all(), f"a puck of {speed} m/s does not come back"
    return -speeds[first, worlds] / speeds[first - 1, worlds], -np.min(gaps)


def chase(env, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return actions that drive mallets at the pucks as fast as the joints turn."""
    place, velocity, mallets = seen(env)
    actions = {}
    for i, (agent, arm) in enumerate(env.scene.arms.items()):
        tcp = env.sim.pose(f"{agent}/tcp")[0]
        rows = np.concatenate(env.sim.jacobian(arm.hand, tcp), axis=1)[:, :, arm.dof]
        error = np.zeros((env.num_envs, 6))
        error[:, :2] = place + 0.1 * velocity - mallets[:, i, :2]
        error[:, 2] = 0.615 - mallets[:, i, 2]
        change = (np.linalg.pinv(rows, rcond=0.05) @ error[..., None])[..., 0]
        change /= np.maximum(np.abs(change / arm.stride).max(axis=1), 1e-9)[:, None]
        wild = rng.uniform(size=(env.num_envs, 1)) < 0.1
        bang = np.sign(rng.uniform(-1, 1, change.shape)) * arm.stride
        actions[agent] = np.where(wild, bang, change) / arm.stride
    return actions


def attack(env, steps: int, shot: float) -> dict[str, float]:
    """Return what the worst was while arms chase pucks that are shot now and then."""
    rng, field = np.random.default_rng(0), env.task.field
    env.reset(seed=0)
    worst = {"speed": 0.0, "in cushion": 0.0, "in mallet": 0.0, "escapes": 0.0}
    last = {}

    def look() -> None:
        place, velocity, mallets = seen(env)
        away = place[:, None] - mallets[..., :2]
        far = np.linalg.norm(away, axis=2)
        is_low = mallets[..., 2] - 0.6 < 0.03
        in_mallet = np.where(is_low, PUCK + MALLET - far, 0.0).max()
        x, y = np.abs(place).T
        in_mouth = y < field.half_goal
        beyond = np.maximum(
            y - (field.half_width - PUCK),
            np.where(in_mouth, 0.0, x - (HALF_LENGTH - PUCK)),
        )
        worst["speed"] = max(worst["speed"], np.linalg.norm(velocity, axis=1).max())
        worst["in cushion"] = max(worst["in cushion"], beyond.max())
        worst["in mallet"] = max(worst["in mallet"], in_mallet)
        # A puck on the other side of a mallet that it did not go round.
        if "away" in last:
            flips = (np.sum(away * last["away"], axis=2) < 0) & is_low & (far < 0.1)
            worst["escapes"] += flips.sum()
        worst["escapes"] += (beyond > 2 * PUCK).sum()
        last["away"] = away

    env.watch(look, shots=SUBSTEPS)
    for step in range(steps):
        if shot and step % 10 == 0:
            place = rng.uniform(-1, 1, (env.num_envs, 2))
            place *= (HALF_LENGTH - 2 * PUCK, field.half_width - 2 * PUCK)
            angle = rng.uniform(0, 2 * np.pi, env.num_envs)
            way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            put(env, place, shot * way)
            last.clear()
        env.step(chase(env, rng))
        if (env.sim.memory["call"] != 0).any():
            last.clear()
    env.watch(None)
    return worst


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--steps", type=int, default=200)
    args = parser.parse_args()
    print("| set | against | m/s | mean | least | most | depth, mm |")
    print("| ---: | --- | ---: | ---: | ---: | ---: | ---: |")
    for restitution in (0.5, 0.8, 1.0):
        task = make_task("HockeyPandas-v0", restitution=restitution)
        env = cg.VectorEnv(task, args.worlds, num_threads=1)
        for name, speed in product(("cushion", "mallet"), SPEEDS):
            found, depth = bounce(env, name, speed)
            print(
                f"| {restitution} | {name} | {speed} | {found.mean():.3f} |"
                f" {found.min():.3f} | {found.max():.3f} | {1000 * depth:.0f} |"
            )
    print(
        "\n| pucks shot at, m/s | fastest | in cushion, mm | in mallet, mm | escapes |"
    )
    print("| ---: | ---: | ---: | ---: | ---: |")
    env = cg.make_vec("HockeyPandas-v0", args.worlds, num_threads=1)
    for shot in SHOTS:
        found = attack(env, args.steps, shot)
        print(
            f"| {shot} | {found['speed']:.1f} | {1000 * found['in cushion']:.0f} |"
            f" {1000 * found['in mallet']:.0f} | {found['escapes']:.0f} |"
        )


if __name__ == "__main__":
    main()
