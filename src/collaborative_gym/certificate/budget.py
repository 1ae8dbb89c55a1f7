"""The effort of a certificate."""

from dataclasses import dataclass

from collaborative_gym.errors import check_number, check_numbers
from collaborative_gym.tasks.settings import bounded, check_settings

_MOST = 10**12  # bound of all numbers, larger than could be spent


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Effort of a certificate.

    Attributes:
      episodes: held-out starts that judge the expert, the motion and the policy.
      fractions: moments at which the still arm freezes, as shares of the expert's time
        to the goal, each from 0.01 to 0.99.
      motion_steps: control steps of a motion; after it the arms hold still.
      knots: points of a motion.
      candidates: motions tried in a round of the search.
      rounds: how often the search draws candidates anew, unless it converges sooner.
      training_starts: starts on which the search finds the one motion for all.
      searched_starts: held-out starts, for each of which a motion is searched; or 0.
      replays: recorded episodes, of the expert and of the baseline if one is shipped,
        the best of which a blind team replays; 0 for no blind team.
      ppo_steps: environment steps of each training; 0 for none.
      ppo_rows: number of still arms beside which a policy is trained: of those beside
        which nobody reached the goal, the ones where somebody came nearest.
    """

    episodes: int = bounded(500, 1, _MOST)
    fractions: tuple[float, ...] = (0.25, 0.5, 0.75)
    motion_steps: int = bounded(50, 1, _MOST)
    knots: int = bounded(6, 2, _MOST)
    candidates: int = bounded(128, 4, _MOST)
    rounds: int = bounded(40, 1, _MOST)
    training_starts: int = bounded(32, 1, _MOST)
    searched_starts: int = bounded(32, 0, _MOST)
    replays: int = bounded(24, 0, _MOST)
    ppo_steps: int = bounded(1_000_000, 0, _MOST)
    ppo_rows: int = bounded(2, 0, _MOST)

    def __post_init__(self) -> None:
        check_settings(self)
        shares = check_numbers("fractions", self.fractions)
        if not shares:
            raise ValueError("fractions must have a share or more, such as 0.5, got ()")
        for share in shares:
            check_number("each of fractions", share, at_least=0.01, at_most=0.99)
        object.__setattr__(self, "fractions", tuple(sorted(set(shares))))


QUICK = Budget(
    episodes=4,
    fractions=(0.5,),
    motion_steps=8,
    knots=2,
    candidates=4,
    rounds=1,
    training_starts=2,
    searched_starts=1,
    replays=2,
    ppo_steps=0,
)
"""Takes seconds, and proves nothing."""
