"""Perception quality of objects, as messages of Collective Perception carry it: 0 to 15.

There is no probability of existence in these messages; receivers see this number instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.v2x.object_table import ObjectTable

MAX_QUALITY = 15  #: of objectPerceptionQuality (TS 102 894-2 v2.2.1)


def quality_of_score(score: Floats) -> Ints:
    """(n,) quality, 0 to 15, of scores (n,) in [0, 1]: without memory, where `PerceptionQuality` is too much."""
    return np.rint(np.clip(score, 0.0, 1.0) * MAX_QUALITY).astype(np.int64)


@dataclass(kw_only=True, eq=False)
class PerceptionQuality:
    """Rates how well a station perceives each of its objects (TS 103 324 v2.1.1, objectPerceptionQuality).

    The mean of three ratings from 0 to 15, rounded down: confidence of the detections and their success, both as
    exponential moving averages, and the age of the object in units of `age_unit_s`.

    alpha: weight of the newest detection in the averages
    age_unit_s: s of age for each point, up to 15
    retention_s: s, after which an object that is no longer perceived is forgotten
    remembered: number of objects that are remembered at most
    """

    alpha: float = 0.5
    age_unit_s: float = 0.1
    retention_s: float = 60.0
    remembered: int = 4096

    def __post_init__(self) -> None:
        check("more than 0 and at most 1", alpha=self.alpha)
        check("more than 0, finite", age_unit_s=self.age_unit_s, retention_s=self.retention_s)
        check("1 or more", remembered=self.remembered)
        self.reset()

    def reset(self) -> None:
        """Forget all objects."""
        columns = (("first_ns", np.int64), ("confidence", np.float64), ("success", np.float64))
        self._table = ObjectTable(*columns, most=self.remembered)

    def rate(self, time_ns: int, ids: Ints, confidence: Floats, detected: Bools | None = None) -> Ints:
        """(n,) quality of objects, 0 to 15; call it once in each frame.

        ids: (n,) no id twice
        confidence: (n,) in [0, 1], of the detections
        detected: (n,) whether each object was detected in this frame, by default all; otherwise its confidence stays
        """
        seen = np.ones(len(ids), bool) if detected is None else detected
        self._table.forget(time_ns - round(self.retention_s * 1e9))
        rows, known = self._table.read(ids)
        weight = np.where(known, self.alpha, 1.0)
        rows["id"], rows["perceived_ns"] = ids, time_ns
        rows["first_ns"] = np.where(known, rows["first_ns"], time_ns)
        newest = np.clip(confidence, 0.0, 1.0)
        rows["confidence"] += np.where(seen, weight, 0.0) * (newest - rows["confidence"])
        rows["success"] += weight * (seen - rows["success"])
        self._table.write(rows)
        age = np.minimum((time_ns - rows["first_ns"]) // round(self.age_unit_s * 1e9), MAX_QUALITY)
        total = MAX_QUALITY * (rows["confidence"] + rows["success"]) + age
        # Sums of averages that should be whole numbers are a little off.
        return np.asarray(np.floor(total / 3.0 + 1e-9), np.int64)
