"""The agent's own free space has the last word on the picture."""

from __future__ import annotations

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.integrity.clusters import ClusterBoxes
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import seen_through
from mast_zenoh.pipelines.mission import MissionEstimator


class FreeSpaceVeto(MissionEstimator):
    """Leaves out objects of the picture whose place the agent's own sensor sees through.

    mission: makes the estimate of own tracks and the objects that are left

    The idea of CAD (Zhang et al., USENIX Security 2024), applied by the receiver, which trusts its own sensor.
    Own tracks are never left out. Agents must have a sweep in each frame (keyexpr_maps/views.toml); without one,
    nothing is left out.

    Weaknesses: objects stay that the sensor does not see the place of, that are displaced by less than about a metre,
    or that are more than 70 m away.
    """

    def __init__(self, *, mission: MissionEstimator) -> None:
        self.mission = mission
        self._view: SweptView | None = None

    def look(self, view: SweptView) -> None:
        self._view = view
        self.mission.look(view)

    def date_picture(self, time_ns: int) -> None:
        self.mission.date_picture(time_ns)

    def estimate(self, time_ns: int, own: ObjectStates, picture: ObjectStates) -> ObjectStates:
        """The objects of both, world frame; see `MissionEstimator.estimate`."""
        boxes = ClusterBoxes(picture.position, picture.velocity, picture.size, picture.yaw)
        through = seen_through(boxes, (self._view,))
        self._view = None
        return self.mission.estimate(time_ns, own, picture.select(~through[:, 0]))
