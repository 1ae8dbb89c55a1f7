"""The tournament: its players and pairings, and how they are played and kept."""

import hashlib
import json
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from collaborative_gym import errors
from collaborative_gym.envs.vector_env import VectorEnv
from collaborative_gym.evaluation import play
from collaborative_gym.evaluation.table import without_nan
from collaborative_gym.files import check_writable, read_sealed, sealed, write_text
from collaborative_gym.policies import AnyPolicy, Policy, as_played, as_policy
from collaborative_gym.policies.network import NetworkPolicy
from collaborative_gym.policies.onnx import SUFFIX, OnnxNetwork
from collaborative_gym.policies.policy import (
    POLICY_FILE,
    STATES,
    commanding,
    group_agents,
    named_policies,
    read_policy,
)
from collaborative_gym.rng import check_seed
from collaborative_gym.tasks.identity import ON_STATE, Identity
from collaborative_gym.tasks.registry import as_task
from collaborative_gym.tasks.task import Task
from collaborative_gym.tournaments.result import Pairing, Tournament

PAIRINGS = "pairings"
"""Folder, in that of a tournament, of a file for each pairing."""

_FORMAT = 1  # number of the files' format; others are refused

_LONGEST_NAME = 200
"""Letters of a player's name: more than a column of a table has room for."""

_KEPT = ("return", "completion", "performance", "time_to_success", "score")
_KEPT += ("length", "diverged")
"""Columns of a stored pairing, the first five by side where there are several."""


@dataclass(frozen=True)
class Player:
    """A policy under a name of its own.

    Attributes:
      name: of the player.
      policies: by agent, with the networks of files read.
      mark: names of scripted policies and digests of trained ones, which differ from
        those of other policies under the same name. None where there is a function,
        since nobody can say whether it is the same one.
    """

    name: str
    policies: Mapping[str, Any]
    mark: str | None

    def misfit(self, agents: Collection[str]) -> str:
        """Return why it cannot command these agents and no others; empty if it can."""
        for policy in {id(own): own for own in self.policies.values()}.values():
            asked = [agent for agent in agents if self.policies[agent] is policy]
            if asked and isinstance(policy, NetworkPolicy):
                try:
                    policy.serving(asked)
                except ValueError as error:
                    return str(error)
        return ""


_Seating = Mapping[str, Player]  # the player of each seat


def tournament(
    env: str | Task,
    policies: Sequence[AnyPolicy] | Mapping[str, AnyPolicy],
    *,
    episodes: int = 100,
    seed: int = 0,
    seats: str | Sequence[str] = "all",
    groups: Mapping[str, Sequence[str]] | None = None,
    num_envs: int | None = None,
    num_threads: int = 0,
    any_env: bool = False,
    output: str | Path | None = None,
    on_pairing: Callable[[Pairing], object] | None = None,
    on_progress: play.OnProgress = None,
) -> Tournament:
    """Play every policy in every seat with every other, and with itself (cross-play).

    A seat is a robot; if the task has several sides, it is a side with all of its
    robots. In a pairing one player has one seat, and another player, or the same one,
    has all other seats. With two seats, these are all pairs in both orders. Every
    pairing plays the same episodes, the first of the seed. The numbers are the same for
    any `num_envs` and `num_threads`.

    A policy file can command the agents that it has networks for. Pairings in which it
    would have to command others, or only some of the robots that one network commands
    together, are left out, and the result says why. All files are read first.

    Args:
      env: an environment id, a task's name, or a task.
      policies: whatever `load_policy` takes, each under the name that the command line
        has for it; or a dictionary of policies by names of your own.
      episodes: number of episodes of each pairing.
      seed: the episodes' seed.
      seats: the seats that each player takes in turn, while another has the rest;
        "all", or names of some.
      groups: players that are training runs of one kind, by the kind's name. None for
        those that are in one folder.
      num_envs: worlds that play at the same time; None for at most 64.
      num_threads: physics threads, 0 for one per CPU.
      any_env: whether trained policies may play another environment than their own.
      output: a folder that keeps each pairing in a file. A pairing that it has is not
        played again, unless a player is a function. So you can continue a tournament
        that was stopped, and add players. None to keep nothing.
      on_pairing: called with each pairing that was played.
      on_progress: called after each step with the share that is done, 0 to 1.

    Raises:
      FileNotFoundError: if there is no such policy file or baseline.
      KeyError: if a name is unknown.
      OSError: if a file cannot be written, as on a full disk; what was there stays.
      TypeError: if something is of another kind.
      ValueError: if a number is out of range, there are fewer than two players or two
        of one name, a policy is for another environment, for other robots or for none
        of the pairings, the task has one robot, or the folder has pairings of something
        else or a damaged file; says what differs.
    """
    episodes = errors.check_count("episodes", episodes, at_least=1)
    seed = check_seed(seed)
    errors.check_callback("on_pairing", on_pairing)
    errors.check_callback("on_progress", on_progress)
    any_env = errors.check_flag("any_env", any_env)
    task = as_task(env)
    world = VectorEnv(
        task, play.worlds_for(episodes, num_envs), num_threads=num_threads
    )
    with closing(world):
        all_seats = _seats(world)
        turns = _turns(seats, all_seats)
        players = enter(policies, world, any_env=any_env)
        names = tuple(player.name for player in players)
        kinds = _groups(groups, names)
        casts, left_out = _casts(players, all_seats, turns)
        settings = {
            "identity": Identity.of(task).to_dict(),
            "episodes": episodes,
            "seed": seed,
        }
        kept = _Kept(output, settings)
        pairings = [kept.read(cast) for cast in casts]
        parts = play.parts_of(on_progress, [1] * len(casts))
        for i, (cast, part) in enumerate(zip(casts, parts, strict=True)):
            if pairings[i] is None:
                given = world, cast, all_seats, settings, num_threads, part
                pairings[i] = played = _play(*given)
                kept.write(cast, played)
                if on_pairing is not None:
                    on_pairing(played)
            if part is not None:
                part(1.0)
    found = tuple(filter(None, pairings))
    return Tournament(
        task.name, settings, all_seats, turns, names, found, kinds, left_out
    )


def _seats(env: VectorEnv) -> dict[str, tuple[str, ...]]:
    if len(env.sides) > 1:
        return dict(env.sides)
    if len(env.agents) < 2:
        raise ValueError(
            f"{env.task.name} has one robot, which has nobody to play with; compare"
            " policies by evaluate"
        )
    return {agent: (agent,) for agent in env.agents}


def _turns(seats: Any, all_seats: Mapping[str, Any]) -> tuple[str, ...]:
    if isinstance(seats, str):
        seats = (seats,)
    errors.check_kind("seats", seats, Sequence, '"all", or names of seats')
    if tuple(seats) == ("all",):
        return tuple(all_seats)
    for seat in seats:
        errors.look_up("seat", seat, all_seats)
    if not seats or len(set(seats)) < len(seats):
        raise ValueError(
            'seats must be "all", or names of some, each once, got'
            f" {errors.shown(seats)}"
        )
    return tuple(seats)


def _groups(groups: Any, names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    if groups is None:
        folders: dict[str, list[str]] = {}
        for name in names:
            # A run's folder, or the policy file in it; not one of a league's players.
            run = Path(name).parent if Path(name).name == POLICY_FILE else Path(name)
            if run.is_dir():
                folders.setdefault(str(run.parent), []).append(name)
        folders.pop(".", None)
        return {k: tuple(runs) for k, runs in folders.items() if len(runs) > 1}
    errors.check_kind("groups", groups, Mapping, "a dictionary of players' names")
    for kind, runs in groups.items():
        if isinstance(runs, str) or not isinstance(runs, Sequence) or len(runs) < 2:
            raise ValueError(
                f"groups[{kind!r}] must list two players or more, got"
                f" {errors.shown(runs)}"
            )
        for run in runs:
            errors.look_up("player", run, dict.fromkeys(names))
    return {str(kind): tuple(runs) for kind, runs in groups.items()}


def _casts(
    players: Sequence[Player],
    seats: Mapping[str, tuple[str, ...]],
    turns: Sequence[str],
) -> tuple[list[_Seating], dict[str, str]]:
    """Return all that can be played, and why the others cannot, by their titles."""
    casts: dict[tuple[str, ...], _Seating] = {}
    left_out: dict[str, str] = {}
    for turn, one, other in product(turns, players, players):
        cast = {seat: one if seat == turn else other for seat in seats}
        key = tuple(player.name for player in cast.values())
        if reason := _misfits(cast, seats):
            left_out[" + ".join(key)] = reason
        else:
            casts[key] = cast
    for player in players:
        if not any(player.name in key for key in casts):
            agents = [agent for own in seats.values() for agent in own]
            raise ValueError(
                f"player {player.name!r} cannot play any of the pairings:"
                f" {player.misfit(agents) or next(iter(left_out.values()))}"
            )
    return list(casts.values()), left_out


def _misfits(cast: _Seating, seats: Mapping[str, tuple[str, ...]]) -> str:
    agents: dict[str, list[str]] = {}
    for seat, player in cast.items():
        agents.setdefault(player.name, []).extend(seats[seat])
    by_name = {player.name: player for player in cast.values()}
    found = {name: by_name[name].misfit(own) for name, own in agents.items()}
    return "; ".join(f"{name!r}: {why}" for name, why in found.items() if why)


def _play(
    env: VectorEnv,
    cast: _Seating,
    seats: Mapping[str, tuple[str, ...]],
    settings: Mapping[str, Any],
    num_threads: int,
    on_progress: play.OnProgress,
) -> Pairing:
    team = {a: player.policies[a] for seat, player in cast.items() for a in seats[seat]}
    episodes, seed = settings["episodes"], settings["seed"]
    task = as_played(env.task, team)  # Some arms may be limp or absent.
    with closing(VectorEnv(task, env.num_envs, num_threads=num_threads)) as world:
        for player in {each.name: each for each in cast.values()}.values():
            for given, agents in group_agents(player.policies, world):
                if isinstance(given, OnnxNetwork):  # It sees more than its seat.
                    whole = given.commanding(agents, world)
                    own = [a for a in agents if team[a] is given]
                    team |= dict.fromkeys(own, whole)
        policy = as_policy(team, world, any_env=True)  # The players have been checked.
        rows, _ = play.play_episodes(world, policy, episodes, seed, on_progress)
    columns = {
        name: tuple(float(row[name]) for row in rows)
        for name in rows[0]
        if name.rpartition("/")[2] in _KEPT
    }
    return Pairing({seat: player.name for seat, player in cast.items()}, columns)


class _Kept:
    """The pairings in a tournament's folder, if there is one, with these settings."""

    def __init__(self, folder: str | Path | None, settings: Mapping[str, Any]):
        self._folder, self._settings = None, settings
        if folder is not None:
            errors.check_kind("output", folder, (str, Path), "a folder's name")
            self._folder = Path(folder) / PAIRINGS
            check_writable(self._folder / "any.json")

    def read(self, cast: _Seating) -> Pairing | None:
        """Return the pairing of a cast, if the folder has it.

        Raises:
          ValueError: if its file is damaged, or of something else.
        """
        if self._folder is None or None in _marks(cast).values():
            return None
        path = self._folder / _file_name(cast)
        if not path.exists():
            return None
        found = read_sealed(path, "remove it, and it is played again")
        try:
            if found["format"] != _FORMAT:
                raise ValueError(f"its format is {found['format']}, not {_FORMAT}")
            columns = {
                str(name): tuple(math.nan if x is None else float(x) for x in column)
                for name, column in found["columns"].items()
            }
            differs = list(self._differences(found, cast))
        except (LookupError, TypeError, ValueError) as error:
            raise ValueError(
                f"{path} is not a pairing: {error}; remove it, and it is played again"
            ) from error
        if differs:
            raise ValueError(
                f"{path.parent} has pairings of something else: {'; '.join(differs)};"
                " choose another output, or remove it"
            )
        return Pairing({seat: player.name for seat, player in cast.items()}, columns)

    def _differences(self, found: Mapping[str, Any], cast: _Seating) -> Iterator[str]:
        own, other = (
            Identity.from_dict(each["identity"]) for each in (self._settings, found)
        )
        yield from own.differences(other, ignore=ON_STATE)
        for name in ("episodes", "seed"):
            if self._settings[name] != found[name]:
                yield f"{name} is {self._settings[name]}, not {found[name]}"
        for name, mark in _marks(cast).items():
            if found["players"][name] != mark:
                yield f"the player {name!r} has changed since"

    def write(self, cast: _Seating, pairing: Pairing) -> None:
        """Keep a pairing, whole or not at all."""
        if self._folder is not None:
            content = {"format": _FORMAT, **self._settings, "players": _marks(cast)}
            content["columns"] = without_nan(pairing.columns)
            write_text(self._folder / _file_name(cast), sealed(content, indent=None))


def _marks(cast: _Seating) -> dict[str, str | None]:
    return {player.name: player.mark for player in cast.values()}


def _file_name(cast: _Seating) -> str:
    """Return a name with those of the players, which no other pairing has."""
    names = [player.name for player in cast.values()]
    words = re.sub(r"[^\w.-]+", "_", "+".join(names))[-80:].strip("_.")
    digest = hashlib.sha256(json.dumps(names).encode()).hexdigest()[:8]
    return f"{words}-{digest}.json"


def enter(
    policies: Sequence[AnyPolicy] | Mapping[str, AnyPolicy],
    env: VectorEnv,
    *,
    any_env: bool = False,
) -> list[Player]:
    """Return the players, with all policies read from their files.

    Raises:
      Exception: as `load_policy` and `named_policies` do; names the player.
      ValueError: if there are fewer than two.
    """
    named = named_policies(policies)
    if len(named) < 2:
        listed = ", ".join(named) or "none"
        raise ValueError(
            f"a tournament needs two policies or more, got {len(named)} ({listed})"
        )
    for name in named:
        if not 0 < len(name) <= _LONGEST_NAME:
            raise ValueError(
                "a player's name, which its policy gives or you, must have 1 to"
                f" {_LONGEST_NAME} letters, got {errors.shown(name)}"
            )
    return [_enter(name, policy, env, any_env) for name, policy in named.items()]


def _enter(name: str, policy: AnyPolicy, env: VectorEnv, any_env: bool) -> Player:
    policies: dict[str, Any] = {}
    marks: dict[str, str | None] = {}
    with errors.naming(f"player {name!r}"):
        for given, agents in group_agents(policy, env):
            own = read_policy(given, env)
            if isinstance(own, NetworkPolicy):
                own.check(env, any_env=any_env)
            elif given not in [*STATES]:  # Their worlds come with the pairing.
                commanding(agents, own, env, any_env)
            policies |= dict.fromkeys(agents, own)
            marks |= dict.fromkeys(agents, _mark(given, own))
    mark = "; ".join(f"{agent} {marks[agent]}" for agent in env.agents)
    return Player(name, policies, None if None in marks.values() else mark)


def _mark(given: Any, found: Policy) -> str | None:
    if isinstance(found, NetworkPolicy):
        return found.digest
    if isinstance(given, str | Path) and Path(given).suffix == SUFFIX:
        return hashlib.sha256(Path(given).read_bytes()).hexdigest()
    return str(given) if isinstance(given, str | Path) else None
