"""The settings of training."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from collaborative_gym.errors import MOST_THREADS, check_count, check_kind, look_up
from collaborative_gym.policies.network import check_activation
from collaborative_gym.tasks.settings import bounded, check_settings

Mode = Literal["collaborative", "independent", "shared", "centralized"]
"""Policies, critics and rewards of the robots.

- collaborative: a policy for each robot on its own observation, and one critic on all
  observations; the robots share their mean reward (MAPPO).
- independent: a policy and a critic for each robot, on its own observation and reward
  (IPPO).
- shared: one policy and one critic for all robots, with the robot's index as an input;
  for robots with equal spaces.
- centralized: one policy observes all, commands all arms, and has their mean reward.

Where a task has several sides, "all" in collaborative and centralized means one side,
and each side has its own critic, and with centralized its own policy. In the mode
shared, opponents play the same policy. Beside partners that do not learn, a robot has
its own critic in collaborative, too, and still the mean reward.
"""

MODES: tuple[Mode, ...] = get_args(Mode)

Algorithm = Literal["ppo", "sac"]
"""PPO learns from the latest policy's rollout alone, SAC from a replay memory."""

Activation = Literal["relu", "elu", "tanh"]
"""The function between a network's layers."""

Network = Literal["flat", "set"]
"""What a network does with an observation: take it as one row of numbers, or take its
set, such as a robot's mates, element by element, whatever their order and number."""

ELEMENT_SIZES = 64, 32
"""Widths of the layers for each element of a set (our choice)."""

PENALTIES = (
    "torque_penalty",
    "contact_penalty",
    "miss_penalty",
    "range_penalty",
    "action_penalty",
)
"""Hyperparameters that charge for more than the reward; 0 charges nothing."""

FAULTS = ("delayed", "lost_grips", "missed_grips")
"""Hyperparameters by which robots do something else than they ask for; 0 for never."""


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """Hyperparameters of PPO and SAC, and of the worlds that they learn from.

    Attributes:
      total_steps: environment steps over all worlds; the last update may go past it.
      num_envs: worlds that collect side by side.
      rollout_steps: control steps in each world between two updates.
      epochs: PPO: passes over a rollout in an update.
      minibatch_size: rows of a gradient step, or as many as an update has. A row is a
        control step of one robot; in collaborative and centralized, of all robots.
      discount: discount factor of rewards, per control step.
      gae_lambda: PPO: trace decay of generalized advantage estimation.
      clip: PPO: clip range of the ratio of an action's new to its old probability.
      entropy: PPO: weight of the policy's entropy in the loss.
      value_weight: PPO: weight of the critic's loss.
      max_grad_norm: largest norm of a gradient; 0 for no limit.
      learning_rate: Adam's first learning rate; with SAC it stays.
      target_kl: PPO: the learning rate falls if an epoch moves the policy by more than
        twice this Kullback-Leibler divergence, and rises below half of it; 0: never.
      min_learning_rate: PPO: least learning rate.
      max_learning_rate: PPO: greatest learning rate.
      replay_size: SAC: rows that the replay memory holds; they are part of each
        checkpoint (120 MB for PassTaskSawyers; our choice; in arXiv 1812.05905,
        Haarnoja et al. 2018b hold 1e6).
      warmup: SAC: rows before the first update (our choice).
      gradient_steps: SAC: gradient steps of an update (our choice, for speed; Haarnoja
        et al. do one after each step of one world).
      polyak: SAC: share by which the target critics follow the critics in a gradient
        step (Haarnoja et al. 2018).
      target_std: SAC: the weight of the entropy is learned so that actions have the
        entropy of a Gaussian with this standard deviation in each component. (The -1 of
        Haarnoja et al. in each component is 0.09.)
      initial_std: standard deviation of the action noise at first.
      initial_grip_std: standard deviation of its grip component.
      final_noise: PPO: share of the action noise at the end. It shrinks after each
        rollout in which half of the episodes are completed. With 1, it does not.
      quiet_share: PPO: share of the total steps, at the end of the run, over which the
        noise shrinks; 0 for none.
      grip_limit: greatest mean of a grip's command, 0 for no limit. Noise of half this
        size still makes a robot let go sometimes, so it learns what this gains.
      grip_persistence: share of the grip's noise, 0 to below 1, that persists in the
        next action. Noise that opens a grip in single steps makes a robot drop what it
        carries; lasting noise tries long holds and long releases.
      assistance: share of the weight of loose things that the simulator carries at
        first. It falls by 0.01 after each rollout in which half of the episodes are
        completed. Validations have none.
      torque_penalty: penalty on torque. In each control step a robot pays this times
        the mean square of the torque that its servos ask for, as a share of their
        limits; beyond a limit the penalty grows linearly. No reported return contains
        penalties. The penalties on torque, contacts and missed goals, late actions and
        failing grips begin at zero. They grow by 2 % after each rollout in which half
        of the episodes are completed.
      contact_penalty: penalty on contacts. In each control step all robots pay this for
        every mm of the deepest contact, at most 10 mm. Contacts of an arm with another
        arm or fixed things count, and contacts of loose things deeper than 1 mm.
        Measuring it makes collecting about a quarter slower.
      miss_penalty: penalty on each control step in which the goal is not met, for tasks
        whose reward hardly changes near the goal.
      range_penalty: penalty on joints at the ends of their ranges, from the beginning.
        In each control step a robot pays this times the mean square of how far its
        joints are in the outer tenth of their ranges.
      action_penalty: PPO: penalty on actions, from the beginning. The loss includes
        this weight times the mean square of the policy's mean actions, without grips. A
        joint at its torque limit moves the same whether the policy asks for the limit
        or for more, so the reward cannot teach the policy to ask for less.
      imitation: PPO: weight of the scripted expert's advice. The loss includes this
        weight times the mean squared difference between the expert's action and the
        policy's mean action (as in Kickstarting, Schmitt et al. 2018, arXiv
        1803.03835). If the partner or opponent is a fixed policy that can also play the
        learner's seat, this policy advises instead of the expert.
      refined: 1 to repeat a physics step as short ones if arms crash, as all other
        worlds do; with 0, training is faster and learns as well.
      delayed: share of the worlds in which each action comes one control step late;
        never in validations, and never for a guest, which may not know delays.
      mishaps: share of the episodes that begin after a mishap of the task (the
        randomization `lost`), from which robots then learn to come back; never in
        validations. A task without mishaps refuses it.
      lost_grips: probability that a robot loses what it holds in a control step,
        whatever its action; 0.005 means about once in an episode. The robot thus learns
        to grip again. This never happens in validations or to guests.
      missed_grips: probability that a robot that holds nothing fails to grip in a
        control step, whatever its action. It thus learns to bring its hand well within
        reach and to keep it there. This never happens in validations or to guests.
      population: number of policies for each robot, if partners are a population.
      league_main_share: share of a league's worlds in which its main policy learns; the
        exploiters share the others (our choice).
      league_self: share of the main policy's worlds in which it plays against itself;
        in AlphaStar's pseudocode (Vinyals et al. 2019) 0.35, as the next numbers.
      league_verify: share of the main policy's worlds in which it plays against
        exploiters, or former versions of itself, that it does not yet beat (0.15).
      league_exploited: the main policy verifies against an exploiter if it gains less
        than this share of the points from it (0.3).
      league_hopeless: an exploiter that gains less than this share of the points from
        the main policy plays former versions of it instead (0.1).
      league_win_rate: a member leaves a copy when it gains more than this share of the
        points from each of its opponents (0.7).
      league_least_steps: least number of environment steps of a member between two
        copies (our choice; AlphaStar's is 2e9).
      league_most_steps: number of steps after which a member leaves a copy in any case;
        our choice (AlphaStar's is 4e9).
      league_reset: probability that the league exploiter restarts after a copy (0.25).
      league_fresh: probability that a restarting member takes the run's initial
        networks instead of main's (our choice).
      league_decay: factor on a game, for each later game of the same two (0.99).
      network: flat for networks that read an observation as one vector; set for
        networks that treat each mate of a robot alike and pool their outputs, so that a
        policy plays in teams of any size. Then the mode shared gives robots no index.
      team_sizes: sizes of further teams, which share the worlds evenly with the task's
        own; for network=set and the mode shared, with arms of one kind.
      hidden_sizes: widths of the hidden layers of policies and critics.
      activation: function between the layers.
      validation_interval: environment steps between validations; 0 for one at the end.
      validation_episodes: episodes of a validation, with the deterministic policy.
    """

    total_steps: int = bounded(3_000_000, 1, 10**15)
    num_envs: int = bounded(256, 1, 10**6)
    rollout_steps: int = bounded(32, 1, 10**6)
    epochs: int = bounded(5, 1, 10**6)
    minibatch_size: int = bounded(2048, 1, 10**9)
    discount: float = bounded(0.97, 0.0, 1.0)
    gae_lambda: float = bounded(0.95, 0.0, 1.0)
    clip: float = bounded(0.2, 1e-3, 1.0)
    entropy: float = bounded(0.0, 0.0, 1.0)
    value_weight: float = bounded(1.0, 0.0, 1e3)
    max_grad_norm: float = bounded(1.0, 0.0, 1e6)
    learning_rate: float = bounded(1e-3, 0.0, 1.0)
    target_kl: float = bounded(0.012, 0.0, 10.0)
    min_learning_rate: float = bounded(1e-5, 0.0, 1.0)
    max_learning_rate: float = bounded(3e-3, 0.0, 1.0)
    replay_size: int = bounded(200_000, 1, 10**9)
    warmup: int = bounded(5_000, 0, 10**9)
    gradient_steps: int = bounded(32, 1, 10**6)
    polyak: float = bounded(0.005, 0.0, 1.0)
    target_std: float = bounded(0.1, 1e-3, 7.0)
    initial_std: float = bounded(0.2, 1e-3, 7.0)
    initial_grip_std: float = bounded(0.3, 1e-3, 7.0)
    final_noise: float = bounded(1.0, 0.01, 1.0)
    quiet_share: float = bounded(0.0, 0.0, 1.0)
    grip_limit: float = bounded(0.0, 0.0, 100.0)
    grip_persistence: float = bounded(0.9, 0.0, 0.999)
    assistance: float = bounded(0.0, 0.0, 1.0)
    torque_penalty: float = bounded(0.0, 0.0, 1e3)
    contact_penalty: float = bounded(0.0, 0.0, 1e3)
    miss_penalty: float = bounded(0.0, 0.0, 1e3)
    range_penalty: float = bounded(0.0, 0.0, 1e3)
    action_penalty: float = bounded(0.0, 0.0, 1e3)
    imitation: float = bounded(0.0, 0.0, 1e6)
    refined: int = bounded(0, 0, 1)
    delayed: float = bounded(0.0, 0.0, 1.0)
    mishaps: float = bounded(0.0, 0.0, 1.0)
    lost_grips: float = bounded(0.0, 0.0, 1.0)
    missed_grips: float = bounded(0.0, 0.0, 1.0)
    population: int = bounded(3, 2, 64)
    league_main_share: float = bounded(0.5, 0.1, 0.9)
    league_self: float = bounded(0.35, 0.0, 0.8)
    league_verify: float = bounded(0.15, 0.0, 0.2)
    league_exploited: float = bounded(0.3, 0.0, 1.0)
    league_hopeless: float = bounded(0.1, 0.0, 1.0)
    league_win_rate: float = bounded(0.7, 0.0, 1.0)
    league_least_steps: int = bounded(100_000, 0, 10**15)
    league_most_steps: int = bounded(250_000, 1, 10**15)
    league_reset: float = bounded(0.25, 0.0, 1.0)
    league_fresh: float = bounded(0.0, 0.0, 1.0)
    league_decay: float = bounded(0.99, 0.0, 1.0)
    network: Network = "flat"
    team_sizes: tuple[int, ...] = ()
    hidden_sizes: tuple[int, ...] = (256, 256)
    activation: Activation = "relu"
    validation_interval: int = bounded(250_000, 0, 10**15)
    validation_episodes: int = bounded(64, 1, 10**6)

    def __post_init__(self):
        check_settings(self)
        for name, most in (("hidden_sizes", 2**16), ("team_sizes", 100)):
            sizes, a = getattr(self, name), "a sequence of integers, such as (256, 256)"
            check_kind(name, sizes, (tuple, list), a)
            checked = [check_count(f"each of {name}", n, 1, most) for n in sizes]
            if isinstance(sizes, list):  # What was not given stays the default itself.
                object.__setattr__(self, name, tuple(checked))
        if not self.hidden_sizes:
            raise ValueError("hidden_sizes must name at least one layer, got ()")
        if self.min_learning_rate > self.max_learning_rate:
            raise ValueError(
                f"min_learning_rate {self.min_learning_rate:g} is above"
                f" max_learning_rate {self.max_learning_rate:g}"
            )
        if self.quiet_share and self.final_noise == 1.0:
            raise ValueError(
                f"quiet_share {self.quiet_share:g} needs a final_noise below 1, which"
                " says how far the noise shrinks"
            )
        if self.warmup > self.replay_size:
            raise ValueError(
                f"warmup {self.warmup} is above replay_size {self.replay_size}, so that"
                " it would never end"
            )
        check_kind("network", self.network, str, "'flat' or 'set'")
        look_up("network", self.network, dict.fromkeys(get_args(Network)))
        check_kind("activation", self.activation, str, "a name, such as 'relu'")
        check_activation(self.activation)

    @property
    def steps_per_update(self) -> int:
        """Environment steps between two updates."""
        return self.num_envs * self.rollout_steps


@dataclass(frozen=True, kw_only=True)
class Resources:
    """Device, threads and collectors of a run, which do not change what it learns.

    Attributes:
      device: torch's device, such as cpu or cuda.
      num_threads: physics threads, 0 for one per CPU; with the backend ray those of
        each collector, 0 for one.
      torch_threads: torch's threads, 0 for one per CPU. With networks this small a
        second one gains nothing, and on a busy machine it costs much. Another number
        may change the last bits of what is learned.
      num_collectors: processes that collect, with the backend ray; 0 for one per CPU.
      ray_address: HOST:PORT of a cluster to join, with the backend ray; none: its own.
    """

    device: str = "cpu"
    num_threads: int = bounded(0, 0, MOST_THREADS)
    torch_threads: int = bounded(1, 0, MOST_THREADS)
    num_collectors: int = bounded(0, 0, MOST_THREADS)
    ray_address: str | None = None

    def __post_init__(self):
        check_kind("device", self.device, str, "a name, cpu or cuda")
        check_settings(self)
        if self.ray_address is not None:
            check_kind("ray_address", self.ray_address, str, "a text, or None")

    @property
    def of_ray(self) -> list[str]:
        """The settings that are given and mean something to the backend ray alone."""
        return [n for n in ("num_collectors", "ray_address") if getattr(self, n)]


_READ = tomllib.loads(Path(__file__).with_name("recipes.toml").read_text())
_USUAL, _ADVICE = _READ["usual"], _READ["advice"]
"""An algorithm's usual hyperparameters, and those of all that learn with advice."""

RECIPES: dict[str, Mapping[str, Any]] = _READ["recipes"]
"""The hyperparameters that suit an environment best, if not the defaults."""

ADVISED: dict[str, Mapping[str, Any]] = _READ["advised"]
"""Numbers of recipes that advice makes needless, taken back."""

_OWN: Mapping[str, Sequence[str]] = {
    "ppo": (
        "epochs",
        "gae_lambda",
        "clip",
        "entropy",
        "value_weight",
        "target_kl",
        "min_learning_rate",
        "max_learning_rate",
        "final_noise",
        "quiet_share",
        "action_penalty",
        "imitation",
    ),
    "sac": ("replay_size", "warmup", "gradient_steps", "polyak", "target_std"),
}
"""Hyperparameters that mean something to only one algorithm."""


def recipe(
    env: str,
    algorithm: str = "ppo",
    *,
    advised: bool = False,
    changes: Mapping[str, Any] | None = None,
) -> Hyperparameters:
    """Return the hyperparameters for an environment: its recipe, or the defaults.

    Recipes are made for PPO. Another algorithm takes from them what means something to
    it, unless it has usual values of its own.

    Args:
      env: its name.
      algorithm: "ppo" or "sac".
      advised: whether it learns with the expert's advice, by numbers that suit this.
      changes: hyperparameters to use in place of these, by name.

    Raises:
      KeyError: if there is no such algorithm or hyperparameter.
      ValueError: if the algorithm takes no advice.
    """
    usual = look_up("algorithm", algorithm, _USUAL)
    if advised and "imitation" in foreign(algorithm):
        raise ValueError(f"{algorithm} takes no advice; leave it out, or choose ppo")
    changes = {} if changes is None else changes
    check_kind("changes", changes, Mapping, "a mapping, or None")
    for name in changes:
        look_up("hyperparameter", name, vars(Hyperparameters()))
    unused = foreign(algorithm)
    own = {n: value for n, value in RECIPES.get(env, {}).items() if n not in unused}
    of_advice = {**_ADVICE, **ADVISED.get(env, {})} if advised else {}
    return Hyperparameters(**{**own, **usual, **of_advice, **changes})


def foreign(algorithm: str) -> set[str]:
    """Return the hyperparameters that mean nothing to an algorithm."""
    return {n for other, own in _OWN.items() if other != algorithm for n in own}


def changed(
    hyperparameters: Hyperparameters, from_: Hyperparameters | None = None
) -> dict[str, object]:
    """Return the hyperparameters that differ from others, None for the defaults."""
    own, others = vars(hyperparameters), vars(from_ or Hyperparameters())
    return {name: own[name] for name in own if own[name] != others[name]}
