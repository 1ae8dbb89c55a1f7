"""How hard grips pull, how far they stretch, and how fast what they lose flies.

    python benchmarks/grips.py [--episodes N] [--json FILE] [ENV_ID ...]

Environments with grips are played by the expert, by the baseline, and by arms that tear
at what they hold: from when all hold, their hands pull apart in a direction drawn for
the episode (`tear`) or for every half second (`jerk`), each joint as hard as it can.

Measured in every physics step of episodes of seed 0: the force on a hand; the sum over
the grips of the greatest distance from a tcp to what it holds, which is how far apart
two hands at one object come; the speed of what was lost in the 0.1 s after a grip tore;
and the greatest speed of a hand. Numbers are median, 99th percentile and maximum over
the episodes.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import collaborative_gym as cg

POLICIES = ("expert", "baseline", "tear", "jerk")
QUANTILES = (0.5, 0.99, 1.0)
JUST_LOST = 10
"""Physics steps after a tear in which the speed of what was lost counts."""


class Recorder:
    """Measures an environment's grips in every physics step."""

    def __init__(self, env: cg.VectorEnv):
        self.sim, self.step_sim = env.sim, env.sim.step
        env.sim.step = self.step  # type: ignore[method-assign]
        model, grips = env.model, env.scene.grips
        self.grips = grips
        self.ids = [model.equality(grip.name).id for grip in grips]
        self.palms = [int(model.sensor(grip.palm).adr[0]) for grip in grips]
        worlds = env.num_envs
        self.force = np.zeros((worlds, len(grips)))
        self.stretch = np.zeros((worlds, len(grips)))
        self.since = np.full(worlds, JUST_LOST)
        self.tears = np.zeros(worlds, int)
        self.lost, self.hand = np.zeros(worlds), np.zeros(worlds)
        body = model.body_rootid[model.site(grips[0].site).bodyid[0]]
        self.dof = int(model.body_dofadr[body])
        self.tcps, self.found = None, np.zeros((worlds, model.nsensordata))

    def step(self, controls, records=None, breaks=None):
        """Do what `Sim.step` does, and measure."""

        def judge(found, active):
            if found.ndim == 3:
                self.found = found[:, 0].copy()
            return breaks(found, active)

        for i in range(controls.shape[1]):
            held = self.sim.eq_active[:, self.ids] > 0
            self.step_sim(controls[:, i : i + 1], records, judge)
            self.measure_forces(held)
            self.measure_tears(held)

    def measure_forces(self, held: np.ndarray) -> None:
        """Take down the forces of a physics step that began with these grips.

        In a world where one tore, the step was taken again; what it first said of the
        forces has not happened.
        """
        is_true = ((self.sim.eq_active[:, self.ids] > 0) == held).all(axis=1)
        for i, palm in enumerate(self.palms):
            force = np.linalg.norm(self.found[:, palm : palm + 3], axis=1)
            force *= held[:, i] & is_true
            self.force[:, i] = np.maximum(self.force[:, i], force)

    def measure_tears(self, held: np.ndarray) -> None:
        """Take down what happened in a physics step that began with these grips."""
        sim = self.sim
        torn = (held & (sim.eq_active[:, self.ids] == 0)).any(axis=1)
        self.tears += torn
        self.since = np.where(torn, 0, self.since + 1)
        speed = np.linalg.norm(sim.qvel[:, self.dof : self.dof + 3], axis=1)
        speed[self.since >= JUST_LOST] = 0.0
        self.lost = np.maximum(self.lost, speed)
        tcps = np.array([sim.pose(f"{grip.agent}/tcp")[0] for grip in self.grips])
        for i, grip in enumerate(self.grips):
            gap = np.linalg.norm(tcps[i] - sim.pose(grip.site)[0], axis=1)
            self.stretch[:, i] = np.maximum(self.stretch[:, i], gap * held[:, i])
        if self.tcps is not None:
            way = np.linalg.norm(tcps - self.tcps, axis=2).max(axis=0)
            self.hand = np.maximum(self.hand, way / 0.01)
        self.tcps = tcps


def pull(env: cg.VectorEnv, directions: np.ndarray) -> dict[str, np.ndarray]:
    """Return actions of arms that pull as hard as they can, their grips on."""
    actions = {}
    for i, (agent, arm) in enumerate(env.scene.arms.items()):
        tcp = env.sim.pose(f"{agent}/tcp")[0]
        jacobian = env.sim.jacobian(arm.hand, tcp)[0][:, :, arm.dof]
        side = directions * (1.0 if i % 2 else -1.0)
        moves = np.sign(np.einsum("wij,wi->wj", jacobian, side))
        actions[agent] = np.concatenate([moves, np.ones((len(moves), 1))], axis=1)
    return actions


def measure(env_id: str, name: str, episodes: int) -> dict[str, object]:
    """Return a row of the table."""
    env = cg.make_vec(env_id, episodes, seed=0, num_threads=1)
    recorder = Recorder(env)
    policy = cg.load_policy(name if name == "baseline" else "expert", env)
    rng, infos = np.random.default_rng(0), {}
    has_begun = np.zeros(episodes, bool)
    observations, _ = env.reset()
    for step in range(env.task.config.max_episode_steps):
        if step % (5 if name == "jerk" else 1000) == 0:
            directions = rng.normal(size=(episodes, 3))
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        actions = dict(policy(observations))
        if name in ("tear", "jerk"):
            holds = [env.scene.holds(env.sim, agent) for agent in env.agents]
            has_begun |= np.all(holds, axis=0)
            for agent, hard in pull(env, directions).items():
                actions[agent] = np.where(has_begun[:, None], hard, actions[agent])
        observations, _, _, _, infos = env.step(actions)
    env.close()
    values = {
        "force": recorder.force.max(axis=1),
        "apart": recorder.stretch.sum(axis=1),
        "lost": recorder.lost,
        "hand": recorder.hand,
    }
    return {
        "environment": env_id,
        "policy": name,
        "episodes": episodes,
        "completion": float(infos["metrics"]["completion"].mean()),
        "torn": float((recorder.tears > 0).mean()),
        "tears": float(recorder.tears.mean()),
        **{k: np.quantile(value, QUANTILES).tolist() for k, value in values.items()},
    }


def show(rows: list[dict[str, object]], console: Console) -> None:
    """Print the rows as a table."""
    table = Table(title="Grips: median, 99th percentile, maximum")
    heads = ("", "policy", "completion", "torn in", "tears", "force, N")
    for head in (*heads, "apart, m", "lost, m/s", "hand, m/s"):
        table.add_column(head, justify="right" if head not in heads[:2] else "left")
    for row in rows:
        table.add_row(
            str(row["environment"]),
            str(row["policy"]),
            f"{100 * row['completion']:.1f} %",
            f"{100 * row['torn']:.0f} %",
            f"{row['tears']:.1f}",
            _listed(row["force"], 0),
            _listed(row["apart"], 3),
            _listed(row["lost"], 2),
            _listed(row["hand"], 2),
        )
    console.print(table)


def _listed(values, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    gripping = [name for name in cg.list_envs() if name.startswith(("Lift", "Pass"))]
    parser.add_argument("names", nargs="*", default=gripping)
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--policies", nargs="*", default=POLICIES)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    jobs = [(name, policy) for name in options.names for policy in options.policies]
    rows = [measure(*job, options.episodes) for job in track(jobs)]
    show(rows, Console(width=140))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
