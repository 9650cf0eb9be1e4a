"""The ego's path ahead, as far as its route is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Floats
from mast_zenoh.attacks.coverage import Coverage

#: m, range of distances ahead of the ego on its path.
PATH_AHEAD_M = (10.0, 60.0)


@dataclass(frozen=True, slots=True)
class Path:
    """A polyline from the ego's position.

    corners: (k, 2) m; along: (k,) m from the ego; speed: m/s, of the ego now
    """

    corners: Floats
    along: Floats
    speed: float
    _samples: Floats = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_samples", self.at(np.arange(0.0, self.along[-1], 1.0))[0])

    def at(self, distance: Floats) -> tuple[Floats, Floats]:
        """Positions (n, 2) m and headings (n,) rad at `distance` (n,) m along the path."""
        position = np.column_stack([np.interp(distance, self.along, self.corners[:, axis]) for axis in (0, 1)])
        segment = np.clip(np.searchsorted(self.along, distance, side="right") - 1, 0, len(self.along) - 2)
        step = self.corners[segment + 1] - self.corners[segment]
        return position, np.arctan2(step[:, 1], step[:, 0])

    def offset(self, position: Floats) -> Floats:
        """Distance (n,) m of positions (n, >= 2) from the path, sampled every metre."""
        offset = position[:, None, :2] - self._samples
        nearest: Floats = np.sqrt((offset * offset).sum(axis=2).min(axis=1))
        return nearest


def path_ahead(coverage: Coverage) -> Path | None:
    """The ego's path on its route and straight on beyond its end; None if unknown."""
    ego = coverage.surroundings.ego_sensor
    if ego is None:
        return None
    route = ego.route
    position_now, _ = route.at(coverage.time_s)
    position_in_1s, _ = route.at(coverage.time_s + 1.0)
    waypoints = route.position[route.time_s > coverage.time_s + 1e-9]
    corners = [position_now[:2]]
    for waypoint in waypoints[:, :2]:
        if np.hypot(*(waypoint - corners[-1])) > 0.5:
            corners.append(waypoint)
    heading = rotation_from_quaternion(route.rotation[-1])[:2, 0]
    corners.append(corners[-1] + 2.0 * PATH_AHEAD_M[1] * heading / np.hypot(*heading))
    table = np.array(corners)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(table, axis=0).T))])
    return Path(table, along, float(np.hypot(*(position_in_1s - position_now)[:2])))
