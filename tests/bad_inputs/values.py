"""Values that are wrong where a count, a number, a name or an array is wanted."""

import math

import numpy as np


class Thing:
    """What fits nowhere."""

    def __repr__(self):
        return "Thing()"


THING = Thing()
DATE = np.datetime64("2026-01-01")
STRUCTURED = np.zeros(1, [("a", float)])

ODD = ("two", b"2", 1j, [1, 2], {}, {1, 2}, THING, DATE, STRUCTURED)
"""Neither a number nor a name."""

NO_COUNT = (*ODD, True, 1.5, math.nan, math.inf, np.timedelta64(1, "s"))
NO_NUMBER = (*ODD, True, math.nan, math.inf, -math.inf, 10**400, np.timedelta64(1, "s"))
NO_NAME = (3, 1.5, b"x", [], {}, {1}, THING, True, "", "no such", math.nan)
NO_PATH = (3, 1.5, [], {}, THING, True)
NO_NUMBERS = (150, "150", b"1", [1.0], ["a", "b", "c"], {1, 2, 3}, {}, THING)
"""No three numbers."""
