import numpy as np

from mast_zenoh.arrays.matching import greedy_matching, neighbours
from mast_zenoh.arrays.states import ObjectStates, canonical_order
from mast_zenoh.scenario import load
from mast_zenoh.tracking import Tracker


class NearestTracker(Tracker):
    """Continues each track with the nearest detection. It does not filter, and drops a track that has no detection.

    gate_m: m, the farthest that an object moves between two frames
    """

    def __init__(self, *, gate_m: float = 3.0) -> None:
        if not gate_m > 0.0:
            raise ValueError(f"gate_m: found {gate_m}, expected more than 0")
        self.gate_m = gate_m
        self.reset()

    def reset(self):
        self.time_ns = -1
        self.tracks = ObjectStates.empty()
        self.rows = np.zeros(0, np.int64)
        self.next_id = 0

    @property
    def matched(self):
        return self.rows

    def step(self, time_ns, detections, view=None):
        variance = [0.16] * 6 + [25.0] * 3  # m^2 of position and size, (m/s)^2 of the velocity, which is unknown
        covariance = np.tile(np.diag(variance), (len(detections), 1, 1))
        names = ("size", "yaw", "score", "class_id")
        columns = {name: getattr(detections, name) for name in names}
        return self.step_states(time_ns, ObjectStates.of(detections.position, covariance=covariance, **columns))

    def step_states(self, time_ns, measured):
        if time_ns < self.time_ns:
            raise ValueError(f"time_ns: found {time_ns}, expected {self.time_ns} or later")
        self.time_ns = time_ns
        order = canonical_order(measured)
        seen = measured.select(order)
        reach = np.full(len(self.tracks), self.gate_m)
        old, new, dx, dy = neighbours(self.tracks.position, seen.position, reach)
        chosen = greedy_matching(old, new, np.hypot(dx, dy))
        ids = np.full(len(seen), -1)
        ids[new[chosen]] = self.tracks.id[old[chosen]]
        fresh = np.flatnonzero(ids < 0)
        ids[fresh] = self.next_id + np.arange(len(fresh))
        self.next_id += len(fresh)
        by_id = np.argsort(ids)
        self.tracks = seen.with_(id=ids).select(by_id)
        self.rows = order[by_id]
        return self.tracks


def scenario(gate_m=3.0):
    _, base = load("baseline")
    base["agents"]["*"]["pipeline"]["tracker"] = dict(type="NearestTracker", gate_m=gate_m)
    return base | dict(name="nearest")
