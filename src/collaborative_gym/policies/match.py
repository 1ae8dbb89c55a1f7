"""The players of a world, and the standing of their match, in a few words."""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

from collaborative_gym.policies.policy import AnyPolicy, name_policy

Sides = Mapping[str, tuple[str, ...]]
"""The agents of each side, by its name."""


def name_players(
    policy: AnyPolicy, sides: Sides, colours: Sequence[str] = ()
) -> dict[str, str]:
    """Return the name of each side's policy, or the last part of its path.

    With several sides it comes after the agents, and the side's colour if it is given,
    such as "robot_1 (red) expert".
    """
    players = {}
    for (side, agents), colour in zip_longest(sides.items(), colours):
        given = [policy[a] if isinstance(policy, Mapping) else policy for a in agents]
        names = [Path(name_policy(each)).name for each in given]
        if len(set(names)) > 1:
            players[side] = ", ".join(map("{} {}".format, agents, names))
        else:
            own = "+".join(agents) + (f" ({colour}) " if colour else " ")
            players[side] = own * (len(sides) > 1) + names[0]
    return players


def standing(players: Mapping[str, str], infos: Mapping[str, Any]) -> str:
    """Return how an episode stands, such as "robot_1 expert 2 : 1 robot_2 main".

    Where there is one side, that is who plays. A second line says that the goal is met
    or, at the end of an episode of several sides, who has won. Players are those of
    `name_players`, and infos of the last step or reset of a batch of one world.
    """
    if len(players) == 1:
        [player] = players.values()
        return f"{player}\nsuccess" if infos["success"][0] else player
    points = _points(players, infos)
    if len(players) == 2:
        (first, one), (second, other) = zip(players.values(), points, strict=True)
        text = f"{first} {one} : {other} {second}"
    else:
        pairs = zip(players.values(), points, strict=True)
        text = ", ".join(f"{player} {own}" for player, own in pairs)
    return f"{text}\n{result(players, infos)}" if infos["ended"][0] else text


def result(players: Mapping[str, str], infos: Mapping[str, Any]) -> str:
    """Return the winner of an episode of several sides, at its end."""
    points = dict(zip(players, map(float, _points(players, infos)), strict=True))
    best = [side for side, own in points.items() if own == max(points.values())]
    return "draw" if len(best) > 1 else f"{players[best[0]]} wins"


def _points(players: Mapping[str, str], infos: Mapping[str, Any]) -> list[str]:
    score = infos["metrics"]["score"]
    return [f"{float(score[side][0]):g}" for side in players]
