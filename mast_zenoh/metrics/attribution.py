"""Attribution: the cause of every error of every estimate.

Pure; see docs/metrics.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mast_zenoh.arrays.states import Bools
from mast_zenoh.metrics.attribution_limits import AttributionLimits
from mast_zenoh.metrics.attributor import Attributor
from mast_zenoh.metrics.causes import (
    Labels,
)
from mast_zenoh.metrics.cut_off import CutOffObjects
from mast_zenoh.metrics.manipulations import Manipulations
from mast_zenoh.metrics.record import TruthTable
from mast_zenoh.metrics.scores import Scores
from mast_zenoh.metrics.withheld import Withheld


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribution(AttributionLimits):
    """Finds the cause of each error; parameters: see `AttributionLimits`."""

    def label(
        self,
        scores: Scores,
        manipulations: Manipulations,
        truth: TruthTable,
        agents: Sequence[str],
        period_s: float,
        cut_off_objects: CutOffObjects | None = None,
        min_points: int = 5,
        withheld: Withheld | None = None,
        displaced: Bools | None = None,
    ) -> Labels:
        """The cause of every false track, missed object and identity switch.

        Covers every estimate of the run.
        manipulations: those of all interposers; their series are those of `scores`
        truth:    of the frames of `scores`, with `agents` as its columns
        period_s: s, frame period
        cut_off_objects:  objects known only to disconnected agents; None: no agent was disconnected
        min_points: lidar points from which an agent sees an object
        withheld: by the command centre; None: it has no integrity stage
        displaced: (n,) rows of `truth` of which a link moved a track; None: none
        """
        cut_off_objects = cut_off_objects or CutOffObjects.nothing()
        return Attributor(
            self, scores, manipulations, truth, agents, period_s, cut_off_objects, min_points, withheld, displaced
        ).labels()
