from dataclasses import dataclass

import numpy as np

from mast_zenoh.scenario import load
from mast_zenoh.v2x import (
    CamDecision,
    CamGeneration,
    CongestionControl,
    Generation,
    GenerationRules,
    RadioChannel,
    RedundancyRule,
)


class NearbyOften(GenerationRules):
    """Sends objects near the station in every frame, and all others once a second.

    near_m: m, from the station
    redundancy: rules that leave out what others have reported
    """

    def __init__(self, *, near_m: float = 30.0, redundancy: tuple[RedundancyRule, ...] = ()) -> None:
        self.near_m = near_m
        self.redundancy = redundancy
        self.all_ns = -1_000_000_000

    def generate(self, perception):
        objects = perception.objects
        due = np.linalg.norm(objects.position - perception.position, axis=1) <= self.near_m
        if perception.time_ns - self.all_ns >= 1_000_000_000:
            self.all_ns = perception.time_ns
            due[:] = True
        rows = np.flatnonzero(due & ~perception.redundant(self.redundancy))
        return Generation(len(rows) > 0, rows[objects.id[rows].argsort()], sensors=False)


class NearerStation(RedundancyRule):
    """Leaves out objects that a station nearer to them has reported."""

    def left_out(self, own, row, origin, reports, predicted):
        of_others = np.linalg.norm(predicted - reports.sender_position, axis=1)
        nearer = of_others < np.linalg.norm(own.position[row] - origin, axis=1)
        result = np.zeros(len(own), bool)
        result[row[nearer]] = True
        return result


class PauseWhenBusy(CongestionControl):
    """Waits after a transmission if the channel is busy.

    bound: busy ratio from which it waits; pause_s: s, for how long
    """

    def __init__(self, *, bound: float = 0.02, pause_s: float = 0.2) -> None:
        self.bound = bound
        self.pause_ns = round(pause_s * 1e9)

    def begin(self, stations):
        self.busy = np.zeros(stations)

    def note_slot(self, slot, busy, time_ns):
        self.busy = busy

    def interval_ns(self, airtime_ns):
        return np.where(self.busy >= self.bound, self.pause_ns, 0)


class Beacon(CamGeneration):
    """Says where the vehicle is at fixed intervals.

    every_s: s, between two messages
    """

    def __init__(self, *, every_s: float = 0.5) -> None:
        self.every_ns = round(every_s * 1e9)
        self.next_ns = 0

    def generate(self, time_ns, position, velocity, yaw):
        due = time_ns >= self.next_ns
        if due:
            self.next_ns = time_ns + self.every_ns
        return CamDecision(due, low_frequency=False)


@dataclass(frozen=True, kw_only=True)
class Disc(RadioChannel):
    """A radio that decodes all within a range, and nothing beyond.

    range_m: m
    """

    range_m: float = 60.0

    def decoding_probability(self, distance):
        return np.where(distance <= self.range_m, 1.0, 0.0)


def scenario(range_m=60.0, redundancy=True):
    _, base = load("congested", ["awareness=true", "n_mobile=3", "background=0"])
    rules = dict(type="NearbyOften", redundancy=[dict(type="NearerStation")] if redundancy else [])
    peer = dict(rules=rules, congestion=dict(type="PauseWhenBusy"), awareness=dict(type="Beacon"))
    base["peers"]["*"] |= peer | dict(memory_s=1.5)
    base["channel"]["radio"] = dict(type="Disc", range_m=range_m)
    return base | dict(name="on_the_air")
