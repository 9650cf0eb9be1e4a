"""The table of a tracker's tracks: one row per track, so that choosing, appending and copying are single operations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.states import CLASSES, Ints, ObjectStates

#: id
#: mean, covariance  (9,), (9, 9) of the state
#: yaw, yaw_variance rad, rad^2
#: turn              evidence, >= 0, for this heading against the opposite one
#: aside             m, running mean of how far measured positions are to the left of predicted ones
#: odds              log-odds of existence
#: record            (9,) fading counts of hits, of misses, and of the classes seen
#: seen              ns, time of the last measurement
#: row               of the last input, -1 where the track coasts
TRACK = np.dtype(
    [
        ("id", "i8"),
        ("mean", "f8", (9,)),
        ("covariance", "f8", (9, 9)),
        ("yaw", "f8"),
        ("yaw_variance", "f8"),
        ("turn", "f8"),
        ("aside", "f8"),
        ("odds", "f8"),
        ("record", "f8", (2 + len(CLASSES),)),
        ("class_id", "i8"),
        ("confirmed", "i8"),
        ("seen", "i8"),
        ("row", "i8"),
    ]
)

#: Columns of the record.
HITS, MISSES, VOTES = 0, 1, 2

#: A table of tracks: (n,) of dtype TRACK.
Tracks = NDArray[np.void]


def empty(n: int) -> Tracks:
    """n rows of zeros."""
    return np.zeros(n, TRACK)


def log_odds(probability: float) -> float:
    """ln(p / (1 - p))."""
    return float(np.log(probability / (1.0 - probability)))


def probability(odds: NDArray[Any]) -> NDArray[np.float64]:
    """(n,) in [0, 1] from (n,) log-odds."""
    return np.asarray(1.0 / (1.0 + np.exp(-odds)))


def to_states(tracks: Tracks) -> ObjectStates:
    """The tracks as object states; nothing is shared with the table."""
    mean = tracks["mean"]
    return ObjectStates(
        id=tracks["id"].copy(),
        position=mean[:, 0:3].copy(),
        velocity=mean[:, 6:9].copy(),
        size=mean[:, 3:6].copy(),
        yaw=tracks["yaw"].copy(),
        covariance=tracks["covariance"].copy(),
        score=probability(tracks["odds"]),
        class_id=tracks["class_id"].astype(np.uint8),
    )


def known_class(class_id: NDArray[np.uint8]) -> Ints:
    """(n,) int64: what is no class is of an unknown one."""
    return np.where(class_id < len(CLASSES), class_id, 0).astype(np.int64)


def vote(tracks: Tracks, class_id: Ints) -> None:
    """Count the class (n,) seen of each track; the majority is its class, the lower index in a tie."""
    record = tracks["record"]
    record[np.arange(len(tracks)), VOTES + class_id] += 1.0
    tracks["class_id"] = record[:, VOTES:].argmax(axis=1)
