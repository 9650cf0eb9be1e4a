"""Batches of tracks and views for tests of integrity stages."""

from collections.abc import Mapping, Sequence

import numpy as np

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.integrity import Batch, SweptView
from mast_zenoh.tracking.view import SensorView

STEP_NS = 100_000_000
CAR = (4.5, 1.8, 1.5)
#: Variances of tracks in the order of COVARIANCE_ORDER.
VARIANCE = (0.04, 0.04, 0.04, 0.02, 0.02, 0.02, 0.25, 0.25, 0.25)

Track = tuple[str, int, tuple[float, float]]


def view(
    place: tuple[float, float], *blocked: tuple[float, float, float], max_range: float = 100.0, height: float = 1.0
) -> SweptView:
    """A view all around from `place`, free up to `max_range`, except where it is blocked.

    blocked: x, y and half width in m: the rays that pass there end at its near edge
    """
    sectors = 360
    free = np.full((4, sectors), max_range)
    azimuth = -np.pi + (np.arange(sectors) + 0.5) * (2.0 * np.pi / sectors)
    for x, y, half in blocked:
        dx, dy = x - place[0], y - place[1]
        distance = float(np.hypot(dx, dy))
        turned = (azimuth - np.arctan2(dy, dx) + np.pi) % (2.0 * np.pi) - np.pi
        within = np.abs(turned) <= np.arctan2(half, distance)
        free[:, within] = np.minimum(free[:, within], distance - 0.9)
    return SweptView(SensorView(np.array([*place, height]), np.eye(3), -np.pi, np.pi, -1.0, 1.0, max_range), free)


def batch(
    tracks: Sequence[Track],
    agents: Sequence[str],
    views: Mapping[str, SweptView] | None = None,
    *,
    frame: int = 0,
    velocity: Mapping[int, tuple[float, float]] | None = None,
    size: Mapping[int, tuple[float, float, float]] | None = None,
) -> Batch:
    """A batch of tracks: agent, cluster, and x and y in m.

    views: by agent; velocity, size: of all tracks of a cluster
    """
    names, clusters, places = zip(*tracks, strict=True) if tracks else ((), (), ())
    position = np.array([[x, y, 0.75] for x, y in places]).reshape(-1, 3)
    labels = np.array(clusters, np.int64)
    states = ObjectStates.of(
        position,
        id=labels,
        velocity=np.array([[*(velocity or {}).get(c, (0.0, 0.0)), 0.0] for c in clusters]).reshape(-1, 3),
        size=np.array([(size or {}).get(c, CAR) for c in clusters]).reshape(-1, 3),
        covariance=np.tile(np.diag(VARIANCE), (len(position), 1, 1)),
    )
    ordered = tuple(sorted(agents))
    return Batch(
        frame * STEP_NS,
        states,
        np.array([ordered.index(name) for name in names], np.int64),
        labels,
        ordered,
        tuple((views or {}).get(name) for name in ordered),
    )
