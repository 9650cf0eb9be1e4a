"""Where the objects of an adversary are said to be: its reports, looked up by place and by object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.metrics.boxes import Boxes, centre_distance, pairs_within
from mast_zenoh.metrics.scores import Table
from mast_zenoh.states import Bools, Floats, Ints

#: m: two adversaries whose false objects are this near each other tell the same lie.
SAME_M = 0.25


@dataclass(frozen=True, slots=True)
class Places:
    """n places: frame (n,) int64 and position (n, 3) m, world frame."""

    frame: Ints
    position: Floats

    def boxes(self) -> Boxes:
        """As boxes without extent, group = frame."""
        n = len(self.frame)
        return Boxes(self.frame, np.zeros(n, np.int64), self.position, np.zeros((n, 3)), np.zeros(n))

    def select(self, mask: Bools) -> Places:
        """The places that a mask (n,) picks."""
        return Places(self.frame[mask], self.position[mask])


def nearest(places: Places, among: Places, radius: float) -> tuple[Ints, Floats]:
    """For each of n places the row of the nearest of `among` in the same frame, -1 if none is within `radius` m, and
    the bird's-eye distance to it, m (inf)."""
    row, distance = np.full(len(places.frame), -1, np.int64), np.full(len(places.frame), np.inf)
    i, j = pairs_within(places.boxes(), among.boxes(), radius)
    apart = centre_distance(places.position[i], among.position[j])
    order = np.lexsort((j, apart, i))
    first = np.ones(len(i), bool)
    first[1:] = np.diff(i[order]) != 0
    best = order[first]
    row[i[best]], distance[i[best]] = j[best], apart[best]
    return row, distance


def shown(attacks: Table, mask: Bools, period_s: float, coast_s: float) -> Places:
    """Where false or displaced objects are, by reports `attacks[mask]`, and where they would have gone at constant
    velocity in the `coast_s` seconds after (or in a gap between) reports: a track of them goes on for a while."""
    columns = {name: column[mask] for name, column in attacks.items()}
    order = np.lexsort((columns["frame"], columns["target"]))
    frame, target = columns["frame"][order], columns["target"][order]
    position = np.column_stack([columns[f"after_{axis}"][order] for axis in "xyz"])
    velocity = np.column_stack([columns[f"v{axis}"][order] for axis in "xyz"])
    coast = round(coast_s / period_s)
    steps = np.full(len(frame), coast + 1)
    steps[:-1] = np.where(np.diff(target) == 0, np.minimum(np.diff(frame), coast + 1), steps[:-1])
    row = np.repeat(np.arange(len(frame)), steps)
    ahead = np.arange(len(row)) - np.repeat(np.cumsum(steps) - steps, steps)
    return Places(frame[row] + ahead, position[row] + velocity[row] * (ahead * period_s)[:, None])


@dataclass(frozen=True, slots=True)
class Hidden:
    """Which truth objects were hidden or displaced, and when: frame and truth id, both (n,), sorted by id and frame."""

    frame: Ints
    truth_id: Ints

    @classmethod
    def of(cls, attacks: Table, mask: Bools, truth: Boxes, radius: float) -> Hidden:
        """From reports `attacks[mask]`; each is of the truth object nearest to where its object was, within `radius`.

        truth: all objects, group = frame
        """
        before = np.column_stack([attacks[f"before_{axis}"][mask] for axis in "xyz"])
        frame = attacks["frame"][mask]
        row, _ = nearest(Places(frame, before), Places(truth.group, truth.position), radius)
        frame, truth_id = frame[row >= 0], truth.id[row[row >= 0]]
        order = np.lexsort((frame, truth_id))
        return cls(frame[order], truth_id[order])

    def lately(self, truth_id: Ints, frame: Ints, within: int) -> Bools:
        """(n,) whether each object was hidden in its frame or in one of the `within` frames before."""
        if len(self.frame) == 0 or len(frame) == 0:
            return np.zeros(len(frame), bool)
        ids = np.unique(self.truth_id)
        span = int(max(self.frame.max(), frame.max())) + 1
        known = np.searchsorted(ids, self.truth_id) * span + self.frame
        code = np.minimum(np.searchsorted(ids, truth_id), len(ids) - 1)
        last = np.searchsorted(known, code * span + frame, side="right") - 1
        found = (last >= 0) & (ids[code] == truth_id)
        same = found & (self.truth_id[last] == truth_id)
        return np.asarray(same & (frame - self.frame[last] <= within))
