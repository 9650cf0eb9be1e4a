"""The gate of clusters: whether two tracks can be of one object, by position, height and velocity."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.tracking.covariance_repair import make_positive_definite
from mast_zenoh.tracking.parameters import check_positive

#: Squared Mahalanobis distance that one in 10,000 of a chi-square distribution with six degrees of freedom exceeds.
SAME_ORIGIN_GATE = 27.86
#: m, per axis, and m/s: standard deviations of errors that no covariance contains, such as those of the agent's pose
#: and of seeing one side of a vehicle only. As measured between honest agents, see `integrity.robust_fusion`.
BIAS_M, BIAS_MPS = 0.3, 0.5

#: Rows of a covariance that count, see `states.COVARIANCE_ORDER`: x y z vx vy vz.
_JOINT = np.array([0, 1, 2, 6, 7, 8])
#: Pairs that are compared at once, which limits the memory.
_CHUNK = 1 << 16


class JointGate:
    """Compares tracks of different agents in position and velocity, in all three dimensions.

    Test of whether two tracks have a common origin (Bar-Shalom, Li, Kirubarajan 2001, section 10; Bar-Shalom and Campo,
    IEEE Transactions on Aerospace and Electronic Systems 22(6), 1986): the squared Mahalanobis distance of the
    difference against a quantile of its chi-square distribution. Errors of trackers of one object share the process
    noise, so the sum of the two covariances is an upper bound. `bias_m` and `bias_mps` widen it once per track.

    gate: squared distance up to which two tracks may be of one object; infinite: no gate
    bias_m, bias_mps: standard deviations per axis of errors that no covariance contains, m and m/s
    """

    def __init__(self, gate: float, bias_m: float, bias_mps: float) -> None:
        check_positive({"gate": gate, "bias_m": bias_m, "bias_mps": bias_mps})
        self.gate = gate
        self._bias = 2.0 * np.array([bias_m**2] * 3 + [bias_mps**2] * 3)
        #: (6,) 1/m² and s²/m²: with these weights, the sum of squared differences is at least the squared distance.
        self.inverse_bias = 1.0 / self._bias

    def apart(self, states: ObjectStates, i: Ints, j: Ints) -> Bools:
        """(p,) whether the tracks in rows i and j (p,) cannot be of one object."""
        joint = motion_of(states)
        result = np.empty(len(i), np.bool_)
        for start in range(0, len(i), _CHUNK):
            part = slice(start, start + _CHUNK)
            result[part] = self._apart(states, joint, i[part], j[part])
        return result

    def _apart(self, states: ObjectStates, joint: Floats, i: Ints, j: Ints) -> Bools:
        difference = joint.take(j, 0)
        difference -= joint.take(i, 0)
        # The bias alone bounds the distance from above, which decides most pairs.
        result: Bools = (difference * difference) @ self.inverse_bias > self.gate
        doubtful = result.nonzero()[0]
        if len(doubtful):
            covariance = self._covariance(states, i.take(doubtful), j.take(doubtful))
            result[doubtful] = squared_distance(difference.take(doubtful, 0), covariance) > self.gate
        return result

    def cost(self, states: ObjectStates, i: Ints, j: Ints) -> Floats:
        """(p,) -2 ln of the likelihood that the tracks in rows i and j (p,) are of one object, up to a constant."""
        joint = motion_of(states)
        covariance = self._covariance(states, i, j)
        cost = squared_distance(joint.take(j, 0) - joint.take(i, 0), covariance)
        return np.asarray(cost + np.linalg.slogdet(covariance)[1])

    def _covariance(self, states: ObjectStates, i: Ints, j: Ints) -> Floats:
        """(p, 6, 6) covariances of the differences."""
        total = np.diag(self._bias) + _joint_covariance(states, i)
        total += _joint_covariance(states, j)
        return total


def motion_of(states: ObjectStates) -> Floats:
    """(n, 6) positions and velocities, m and m/s."""
    return np.concatenate([states.position, states.velocity], axis=1)


def _joint_covariance(states: ObjectStates, rows: Ints) -> Floats:
    """(p, 6, 6) covariances of positions and velocities."""
    return make_positive_definite(states.covariance.take(rows, 0)[:, _JOINT[:, None], _JOINT])


def squared_distance(difference: Floats, covariance: Floats) -> Floats:
    """(p,) squared Mahalanobis distances of differences (p, m), with covariances (p, m, m)."""
    return np.asarray(np.vecdot(difference, np.linalg.solve(covariance, difference[:, :, None])[:, :, 0]))
