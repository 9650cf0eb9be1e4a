"""What the agents' sensors cover, and how far each direction is free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_quaternion
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.kernels import kernel
from mast_zenoh.messages.layout import MAX_ROWS
from mast_zenoh.tracking.view import SensorView

#: Limit on the directions of one view; the finest of our sensors has 2,880.
MAX_CELLS = 20_000
#: Free space of a sensor without a sweep.
UNKNOWN_SPACE = np.zeros((0, 0))
UNKNOWN_SPACE.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class SweptView:
    """The field of view of one sensor, and its free space.

    view: field of view
    free: (bands, sectors) m that each direction is free, over the limits of the field of view; (0, 0): unknown
    age_s: s, of the view at the time of the batch
    """

    view: SensorView
    free: Floats
    age_s: float = 0.0

    def ranges(self, points: Floats) -> tuple[Floats, Floats, Bools]:
        """Range, free distance in their direction, and whether in view, of points (m, 3).

        Each (m,). World frame, m. The free distance of a direction without information is not a number.
        """
        return free_ranges(points, self.view, self.free)


@kernel
def free_ranges(points: Floats, view: SensorView, free: Floats) -> tuple[Floats, Floats, Bools]:
    """See `SweptView.ranges`; free: (bands, sectors) m."""
    x, y, z = ((points - view.position) @ view.rotation).T
    ground = np.hypot(x, y)
    distance = np.hypot(ground, z)
    azimuth, elevation = np.arctan2(y, x), np.arctan2(z, ground)
    inside = (distance <= view.max_range) & (elevation >= view.elevation_min) & (elevation <= view.elevation_max)
    width = view.azimuth_max - view.azimuth_min
    turned = (azimuth - view.azimuth_min) % (2 * np.pi)
    inside &= turned <= width
    if free.size == 0:
        return distance, np.full(len(points), np.nan), inside
    bands, sectors = free.shape
    height = view.elevation_max - view.elevation_min
    band = np.clip(((elevation - view.elevation_min) * (bands / height)).astype(np.int64), 0, bands - 1)
    sector = np.clip((turned * (sectors / width)).astype(np.int64), 0, sectors - 1)
    return distance, np.where(inside, free[band, sector], np.nan), inside


def view_columns(view: SensorView, free: Floats) -> dict[str, NDArray[Any]]:
    """The columns of a `view` message."""
    return {
        "position": view.position,
        "rotation": quaternion_from_rotation(view.rotation),
        "azimuth": np.array([view.azimuth_min, view.azimuth_max]),
        "elevation": np.array([view.elevation_min, view.elevation_max]),
        "max_range": np.array([view.max_range]),
        "free": free,
    }


def view_of(body: Mapping[str, NDArray[Any]], age_s: float = 0.0) -> SweptView:
    """The view in a `view` message that `check_view` accepts. age_s: s, see `SweptView`"""
    limits = (*body["azimuth"].tolist(), *body["elevation"].tolist(), float(body["max_range"][0]))
    return SweptView(
        SensorView(body["position"], rotation_from_quaternion(body["rotation"]), *limits), body["free"], age_s
    )


def check_view(body: Mapping[str, NDArray[Any]]) -> None:
    """Raise ValueError for a `view` message that describes no field of view."""
    for name, most in (("azimuth", 2 * np.pi + 1e-6), ("elevation", np.pi + 1e-6)):
        low, high = body[name].tolist()
        if not 0.0 < high - low <= most:
            raise ValueError(f"{name}: found {low:.4g} to {high:.4g}, expected an ascending range up to {most:.4g} rad")
    if not body["max_range"][0] > 0.0:
        raise ValueError(f"max_range: found {body['max_range'][0]}, expected more than 0 m")
    if body["free"].size > MAX_CELLS:
        raise ValueError(f"free: found {body['free'].size} directions, expected at most {MAX_CELLS}")
    if body["free"].size and body["free"].min() < 0.0:
        raise ValueError(f"free: found {body['free'].min()}, expected 0 m or more")


def collated_columns(bodies: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """The columns of a `views` message from those of `view` messages.

    Without names and ages. Beyond MAX_ROWS directions in all, the free space of the last agents is left out.
    """
    shapes = {"position": (3,), "rotation": (4,), "azimuth": (2,), "elevation": (2,)}
    columns: dict[str, NDArray[Any]] = {
        name: np.array([body[name] for body in bodies], np.float64).reshape(len(bodies), *shape)
        for name, shape in shapes.items()
    }
    columns["max_range"] = np.array([body["max_range"][0] for body in bodies], np.float64)
    fits = np.cumsum([body["free"].size for body in bodies]) <= MAX_ROWS
    free = [body["free"] if fit else UNKNOWN_SPACE for body, fit in zip(bodies, fits.tolist(), strict=True)]
    columns["grid"] = np.array([grid.shape for grid in free], np.int64).reshape(len(bodies), 2)
    columns["free"] = np.concatenate([np.zeros(0), *(grid.ravel() for grid in free)])
    return columns


def views_of(body: Mapping[str, NDArray[Any]]) -> dict[str, SweptView]:
    """The views in a `views` message, by agent.

    Raises ValueError if the grids do not fit the free distances.
    """
    grids: Any = body["grid"]
    ends = np.cumsum([0, *(int(bands) * int(sectors) for bands, sectors in grids.tolist())])
    if (grids < 0).any() or ends[-1] != len(body["free"]):
        raise ValueError(f"grid: {ends[-1]} directions, expected {len(body['free'])}, those in `free`")
    limits = np.column_stack([body["azimuth"], body["elevation"], body["max_range"]]).tolist()
    return {
        str(name): SweptView(
            SensorView(body["position"][row], rotation_from_quaternion(body["rotation"][row]), *limits[row]),
            body["free"][ends[row] : ends[row + 1]].reshape(grids[row]),
            float(body["age_ns"][row]) * 1e-9,
        )
        for row, name in enumerate(body["agents"])
    }
