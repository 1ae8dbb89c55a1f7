"""Two robots each carry a cube of their own to a target.

Random: joints, cubes, targets. Success: both cubes within 0.05 m of their targets.
"""

from types import SimpleNamespace

import numpy as np

import collaborative_gym as cg
from collaborative_gym import math, motion, objects

CUBES = np.array([[0.8, -0.6, 0.66], [0.8, 0.6, 0.66]])
TARGETS = np.array([[1.0, -1.0, 1.2], [1.0, 1.0, 1.2]])
DOWN, AHEAD = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])


class SimplePick(cg.Task):
    gripping = True

    def build(self, scene):
        for agent, at in zip(self.agents, CUBES, strict=True):
            scene.add_robot(agent, self.robots[agent], placement=self.placements[agent])
            scene.add(f"{agent} table", objects.table(0.5, 1), position=at * (1, 1, 0))
            scene.add(f"{agent} cube", objects.cube(), position=at)
            scene.add_grip(agent, f"{agent} cube/centre", threshold=0.03, width=0.05)
            scene.add_target(f"{agent} target", radius=0.05)

    def reset(self, sim, env_ids, *, rng):
        put, bounds = self.scene.place, self.config.randomization
        self.start_arms(sim, env_ids, rng=rng)
        for i, agent in enumerate(self.agents):
            place = CUBES[i] + rng.within(bounds.object_position * cg.LEVEL, 3)
            turn = math.from_yaw(rng.within(bounds.object_yaw))
            put(sim, env_ids, name=f"{agent} cube", position=place, quat=turn)
            place = TARGETS[i] + rng.within(bounds.target_position, 3)
            put(sim, env_ids, name=f"{agent} target", position=place)

    def measure(self, sim):
        facts = SimpleNamespace(seen={}, tcp={}, holds={}, to_cube={}, to_target={})
        for agent, joints in self.joints(sim).items():
            tcp, cube = sim.pose(f"{agent}/tcp"), sim.pose(f"{agent} cube/centre")
            place, holds = sim.pose(f"{agent} target")[0], self.scene.holds(sim, agent)
            seen = {"joints": joints, "tcp": math.pose(*tcp)}
            seen |= {"holds": holds[:, None], "cube": math.pose(*cube), "target": place}
            facts.seen[agent], facts.tcp[agent], facts.holds[agent] = seen, tcp, holds
            facts.to_cube[agent] = math.distance(tcp[0], cube[0])
            facts.to_target[agent] = math.distance(cube[0], place)
        return facts

    def observe(self, facts):
        return facts.seen

    def reward(self, facts, commands):
        terms = {agent: {"reach": -far} for agent, far in facts.to_cube.items()}
        for agent, own in terms.items():
            own["carry"] = -facts.to_target[agent]
            own["effort"] = -0.01 * math.norm(commands[agent].moves)
            own["grip"] = 0.1 * facts.holds[agent]
        return terms

    def success(self, facts):
        return np.max(list(facts.to_target.values()), axis=0) < 0.05

    def expert(self, sim, facts):
        motions = {}
        for agent, arm in self.scene.arms.items():
            tcp, holds = facts.tcp[agent], facts.holds[agent][:, None]
            cube, target = (facts.seen[agent][it][:, :3] for it in ("cube", "target"))
            gap = motion.standoff(tcp[0] - cube, DOWN, slack=0.01, least=0.0, most=0.1)
            place = np.where(holds, target, cube - gap * DOWN)
            goal, home = (place, np.where(holds, AHEAD, DOWN)), arm.robot.home
            change = motion.reach(sim, arm, tcp=tcp, goal=goal, posture=home)
            grips = facts.holds[agent] | (facts.to_cube[agent] < 0.015)
            motions[agent] = cg.Motion(change, grips)
        return motions


cg.register_env(cg.EnvSpec("SimplePick-v0", SimplePick, ("sawyer", "sawyer")))
