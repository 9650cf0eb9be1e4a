"""How near and how recent the cause of an error must be."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class AttributionLimits:
    """How near and how recent the cause of an error must be.

    lie_m:     m, maximum distance from a false track to the object that an adversary inserted or moved there; the gate
               of the scorer: a track that is farther away is of something else
    same_m:    m, adversaries whose false objects are this near each other show the same object
    object_m:  m, maximum distance from a duplicate track, or the track of an unevaluated object, to the truth object
    astray_m:  m, maximum distance from an inaccurate track to its missed truth object
    hidden_m:  m, maximum distance from where an object was removed, moved or altered to its truth object
    least_move_m: m, smaller displacements do not count, because the metrics cannot detect them
    withheld_m: m, maximum distance from a missed truth object to the object that the command centre withheld
    coast_s:   s, how long a track may coast, and an estimate may be wrong after a manipulation
    begin_s:   s, how long an object may have no track after it has come into view, was hidden or was withheld
    late_picture_s: s, how long an estimate may be wrong after a link delayed a picture
    Raises ValueError for a value below 0.
    """

    lie_m: float = 2.0
    same_m: float = 0.25
    object_m: float = 3.0
    astray_m: float = 6.0
    hidden_m: float = 4.0
    least_move_m: float = 0.5
    withheld_m: float = 2.0
    coast_s: float = 4.0
    begin_s: float = 1.0
    late_picture_s: float = 0.5

    def __post_init__(self) -> None:
        for field in fields(self):
            if not 0.0 <= (value := getattr(self, field.name)) < np.inf:
                raise ValueError(f"{field.name}: found {value}, expected 0 or more")
