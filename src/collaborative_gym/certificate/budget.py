"""How hard a certificate tries."""

from dataclasses import dataclass

from collaborative_gym.errors import check_count, check_number, check_numbers


@dataclass(frozen=True, kw_only=True)
class Budget:
    """How hard a certificate tries.

    Attributes:
      episodes: held-out starts on which the expert, the motion and the trained policy
        are judged.
      fractions: where the still arm froze, as shares of the time in which the expert
        reaches the goal, each above 0 and below 1.
      motion_steps: control steps of a motion that is searched for; it holds still then.
      knots: points that a motion goes through.
      candidates: motions tried in a round of the search.
      rounds: of the search.
      training_starts: starts on which the one motion for all is searched for.
      searched_starts: held-out starts for each of which a motion of its own is searched
        for, with the simulator at hand; 0 for none.
      ppo_steps: environment steps of each training; 0 for none.
      ppo_rows: how many still arms are trained against: those where nobody reached the
        goal, the nearest first.
    """

    episodes: int = 500
    fractions: tuple[float, ...] = (0.25, 0.5, 0.75)
    motion_steps: int = 50
    knots: int = 6
    candidates: int = 128
    rounds: int = 12
    training_starts: int = 16
    searched_starts: int = 32
    ppo_steps: int = 1_000_000
    ppo_rows: int = 2

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == "fractions":
                shares = check_numbers(name, value)
                for share in shares:
                    check_number("each of fractions", share, above=0.0, at_most=0.99)
                object.__setattr__(self, name, tuple(sorted(set(shares))))
            else:
                check_count(name, value, _LEAST.get(name, 1), _MOST)


_LEAST = {"knots": 2, "candidates": 4, "searched_starts": 0} | dict.fromkeys(
    ("ppo_steps", "ppo_rows"), 0
)
_MOST = 10**12

QUICK = Budget(
    episodes=4,
    fractions=(0.5,),
    motion_steps=8,
    knots=2,
    candidates=4,
    rounds=1,
    training_starts=2,
    searched_starts=1,
    ppo_steps=0,
)
"""Takes seconds, and proves nothing."""
