"""What a command centre with an integrity stage kept out of the picture, as it publishes it. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.metrics.causes import WITHHELD, joined_names
from mast_zenoh.metrics.histories import Histories
from mast_zenoh.metrics.lookup import occurs
from mast_zenoh.metrics.places import Places, nearest
from mast_zenoh.metrics.record import LOCAL, RECEIVED
from mast_zenoh.metrics.scores import MATCHED, Scores, Texts
from mast_zenoh.metrics.trust import TrustHistory, TrustUpdate, lasting


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

    def set_causes(
        self,
        scores: Scores,
        agents: Sequence[str],
        truths: Histories,
        missed: Bools,
        limits: tuple[float, int],
        cause: Ints,
        by: Texts,
    ) -> None:
        """Set the cause of missed objects that were withheld, and the agents that reported them.

        That comes before all other causes: the centre had the object.
        missed: (n,) rows of `truths` that the command centre's estimates lack;  cause, by: of `scores.judged`
        limits: m, distance from a withheld object, and number of frames for which a suspension counts after its end
        """
        rows, (radius, lasts) = missed.nonzero()[0], limits
        frame = truths.frame[rows]
        tracked = nearest(Places(frame, truths.position[rows]), self.places, radius)[0] >= 0
        by_agent = reporting(scores, agents, truths.id[rows], frame)
        suspended = lasting(self.suspended, lasts)[frame]
        chosen = tracked | (by_agent.any(axis=1) & ~(by_agent & ~suspended).any(axis=1))
        cause[truths.row[rows[chosen]]] = WITHHELD
        by[truths.row[rows[chosen]]] = joined_names(agents, by_agent[chosen])


def reporting(scores: Scores, agents: Sequence[str], truth_id: Ints, frame: Ints) -> Bools:
    """Whether the broker received a good track of each of n objects in frames from each agent: (n, a)."""
    judged, series = scores.judged, scores.every_series
    result = np.zeros((len(truth_id), len(agents)), bool)
    matched = np.flatnonzero(~judged.is_track & (judged.outcome == MATCHED))
    for column, agent in enumerate(agents):
        received = series.get((agent, RECEIVED), series.get((agent, LOCAL), -1))
        own = matched[judged.series[matched] == received]
        result[:, column] = occurs((truth_id, frame), (judged.id[own], judged.frame[own]))
    return result
