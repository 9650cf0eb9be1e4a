"""Columns of the tables that NumPy and the kernels share.

The build passes them to the C compiler. Imports nothing, as the build loads this file alone.
"""

#: Number of object classes, each with a column of votes.
N_CLASSES = 7

# -- tracks of a tracker (`tracking.tracks`) -------------------------------------------------------------------------

#: The state x y z l w h vx vy vz (9) comes first; then its covariance (81, by rows).
P = 9
#: Variances and covariance of the horizontal position, m^2.
XX, XY, YY = P, P + 1, P + 10
#: rad; rad^2; and votes, >= 0, for this heading against the opposite one.
YAW, YAW_VARIANCE, TURN = P + 81, P + 82, P + 83
#: m, running mean of the offset of measured positions to the left of predicted ones.
LATERAL_RESIDUAL = P + 84
#: Odds of existence, p / (1 - p).
ODDS = P + 85
#: Decaying counts of hits, of misses, and of votes for each class.
HITS, MISSES, VOTES = P + 86, P + 87, P + 88
CLASS = VOTES + N_CLASSES
#: 1 for a confirmed track, else 0.
CONFIRMED = CLASS + 1
#: s since the last measurement.
AGE = CLASS + 2
ID = CLASS + 3
#: Row of the last input; -1: coasting.
ROW = CLASS + 4
#: Mean score of the measurements; s from the first one to the last, and at which the next sample of it is due.
SCORE, SPAN, DUE = CLASS + 5, CLASS + 6, CLASS + 7
#: Variances and covariance of the horizontal position, m^2, that last: averaging does not reduce them.
LASTING_XX, LASTING_XY, LASTING_YY = CLASS + 8, CLASS + 9, CLASS + 10
WIDTH = CLASS + 11

# -- objects that an adversary follows (`attacks.following`) ---------------------------------------------------------

#: The position (3) m comes first; then velocity (3) m/s.
FOLLOWED_VX = 3
#: s since last seen; s since the track began; number of messages in which it was seen.
FOLLOWED_UNSEEN, FOLLOWED_AGE, FOLLOWED_HITS = 6, 7, 8
#: The victim's id, -1: messages have none; and number of the target, -1: not a target.
FOLLOWED_ID, FOLLOWED_TARGET = 9, 10
#: Row in the newest message; -1: not seen.
FOLLOWED_ROW = 11
FOLLOWED_COLUMNS = 12


def macros() -> list[tuple[str, str]]:
    """(name, value) of every number of this file, as the C compiler takes it."""
    return [(f"MAST_{name}", str(value)) for name, value in globals().items() if name.isupper()]
