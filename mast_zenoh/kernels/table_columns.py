"""Columns of the tables that NumPy and the kernels share.

The build passes them to the C compiler. Imports nothing, as the build loads this file alone.
"""

#: Classes of objects, each with a column of votes.
N_CLASSES = 7

# -- tracks of a tracker (`tracking.tracks`) -------------------------------------------------------------------------

#: The state x y z l w h vx vy vz (9) comes first; then its covariance (81, by rows).
P = 9
#: Of the horizontal position: variances and covariance, m^2.
XX, XY, YY = P, P + 1, P + 10
#: rad, rad^2; and the evidence, >= 0, for this heading against the opposite one.
YAW, YAW_VARIANCE, TURN = P + 81, P + 82, P + 83
#: m, running mean of how far measured positions are to the left of predicted ones.
LATERAL_RESIDUAL = P + 84
#: Odds of existence, p / (1 - p).
ODDS = P + 85
#: Fading counts of hits, of misses, and of the classes seen.
HITS, MISSES, VOTES = P + 86, P + 87, P + 88
CLASS = VOTES + N_CLASSES
#: 1 once it has been confirmed, else 0.
CONFIRMED = CLASS + 1
#: s since the last measurement.
AGE = CLASS + 2
ID = CLASS + 3
#: Row of the last input, -1 where the track coasts.
ROW = CLASS + 4
WIDTH = CLASS + 5

# -- objects that an adversary follows (`attacks.following`) ---------------------------------------------------------

#: Place (3) m comes first; then velocity (3) m/s.
FOLLOWED_VX = 3
#: s since it was last seen, and since it began; messages in which it was seen.
FOLLOWED_UNSEEN, FOLLOWED_AGE, FOLLOWED_HITS = 6, 7, 8
#: The victim's id, -1: the wire has none; number of the target that it is, -1: none.
FOLLOWED_ID, FOLLOWED_TARGET = 9, 10
#: Row of the newest message, -1: not seen in it.
FOLLOWED_ROW = 11
FOLLOWED_COLUMNS = 12


def macros() -> list[tuple[str, str]]:
    """(name, value) of every number of this file, as the C compiler takes it."""
    return [(f"MAST_{name}", str(value)) for name, value in globals().items() if name.isupper()]
