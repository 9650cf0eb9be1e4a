"""What a command centre with an integrity stage kept out of the picture, as it publishes it. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.metrics.places import Places
from mast_zenoh.metrics.trust import TrustHistory, TrustUpdate


@dataclass(frozen=True, slots=True, eq=False)
class Withheld:
    """The objects that were kept out of the picture, and the agents whose tracks were.

    places:    the objects that the centre tracked and withheld; group = frame
    suspended: (span, a) whether agent a is suspended, by frame number
    """

    places: Places
    suspended: Bools

    @classmethod
    def of(cls, updates: Sequence[TrustUpdate], agents: Sequence[str], frames: Ints, state: int) -> Withheld | None:
        """What messages about trust tell; None without any.

        frames: (f,) ascending; state: index of the state of suspended agents
        """
        if not updates or not len(frames):
            return None
        rows = [np.flatnonzero(update.columns["withheld"]) for update in updates]
        frame = np.repeat(np.array([update.frame for update in updates], np.int64), [len(row) for row in rows])
        parts = [update.columns["position"][row] for update, row in zip(updates, rows, strict=True)]
        suspended = np.zeros((int(frames[-1]) + 1, len(agents)), bool)
        suspended[frames] = TrustHistory.of(updates, agents, frames).state == state
        return cls(Places(frame, np.concatenate(parts)), suspended)
