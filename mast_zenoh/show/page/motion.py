"""The boxes of a page with their motion, and columns packed into few bytes.

A column is written as differences (where neighbours are alike), folded to non-negative numbers, and split into planes:
first the lowest byte of every number, then the next. Planes of small differences are mostly zeros, so deflate removes
them. The page's `js/run.js` is the reader.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Body
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.runs.files import Table
from mast_zenoh.runs.run import Run

#: m, greatest standard deviation that is kept: more is not drawn.
_MOST_M = 300.0


class View(NamedTuple):
    """An estimate of an agent that has its own boxes."""

    agent: str
    estimate: str


class Meaning(NamedTuple):
    """What a box is in a view: outcome, cause and adversary (empty: none)."""

    outcome: str
    cause: str
    by: str


@dataclass(frozen=True, eq=False)
class Judgements:
    """The meaning of m boxes in v views.

    boxes:    of the page, those of one object in consecutive rows; their groups are frames
    is_truth: (m,) whether a box is the truth, not a track;  score: (m,) 0 to 1, 0 for truth
    codes:    (v, m) 0: not in this view; otherwise 1 + the row of `meanings`
    matches:  (v, m) id of the object that a matched track follows; -1: none
    """

    boxes: Boxes
    is_truth: Bools
    score: Floats
    views: tuple[View, ...]
    meanings: tuple[Meaning, ...]
    codes: NDArray[np.uint16]
    matches: Ints


def row_keys(*columns: NDArray[np.generic]) -> NDArray[np.uint64]:
    """(n,) A 64-bit hash of the bits of each row."""
    result = np.zeros(len(columns[0]), np.uint64)
    for values in columns:
        numbers = np.asarray(values, np.float64)
        for part in numbers.T if numbers.ndim > 1 else [numbers]:
            bits = np.ascontiguousarray(part + 0.0).view(np.uint64)
            result = (result ^ bits) * np.uint64(0x9E3779B97F4A7C15)
            result ^= result >> np.uint64(29)
    return result


def motion_of(judged: Judgements, truth: tuple[Ints, ObjectStates], tracks: Iterable[tuple[int, Body]]) -> Table:
    """What is known of m boxes besides their geometry.

    known:    (m,) bool;  the other columns are 0 where it is False
    velocity: (m, 2) m/s, world frame
    spread:   (m, 3) standard deviations in m of x and of y, and their correlation; 0: exact, or not known
    kind:     (m,) index into CLASSES

    truth:  the objects of the scene, and (n,) their frames
    tracks: frame and columns of the messages that hold the tracks, on every leg of their wires
    """
    boxes, (frames, states) = judged.boxes, truth
    count = len(boxes)
    motion = {
        "known": np.zeros(count, bool),
        "velocity": np.zeros((count, 2)),
        "spread": np.zeros((count, 3)),
        "kind": np.zeros(count, np.int64),
    }
    keys, of_tracks = _motion_of_tracks(tracks)
    scene: Table = {"velocity": states.velocity[:, :2], "kind": states.class_id}
    own = row_keys(boxes.group, boxes.id)
    placed = row_keys(boxes.group, boxes.id, boxes.position[:, :2])
    for own_keys, wanted, known_keys, values in (
        (own, judged.is_truth, row_keys(frames, states.id), scene),
        (placed, ~judged.is_truth, keys, of_tracks),
    ):
        if not len(known_keys):
            continue
        order = np.argsort(known_keys, kind="stable")
        place = order[np.minimum(np.searchsorted(known_keys, own_keys, sorter=order), len(known_keys) - 1)]
        found = (known_keys[place] == own_keys) & wanted
        motion["known"][found] = True
        for name in values:
            motion[name][found] = values[name][place[found]]
    return motion


def recorded_tracks(run: Run) -> Iterator[tuple[int, Body]]:
    """Frame and columns of all recorded tracks in the frames of the sample."""
    every = run.files.sample.step
    times_ns = (
        None if run.files.scene is None or every == 1 else run.files.scene.times_ns[run.files.sample.start :: every]
    )
    for message in read(run.path, lambda channel: channel.get("message") in ("tracks", "picture"), times_ns):
        if not message.malformed and (message.frame - run.files.sample.start) % every == 0:
            yield message.frame, codec.decode_lazily(message.payload, message.type).body


def _motion_of_tracks(tracks: Iterable[tuple[int, Body]]) -> tuple[NDArray[np.uint64], Table]:
    """Keys of tracks with the columns of `motion_of`."""
    keys, velocity, spread, kind = [], [], [], []
    for frame, body in tracks:
        position, covariance = body["position"], body["covariance"]
        keys.append(row_keys(np.full(len(position), frame), body["id"], position[:, :2]))
        velocity.append(body["velocity"][:, :2])
        x, y, both = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
        deviations = np.sqrt(np.maximum(np.stack([x, y], axis=1), 0.0))
        product = np.maximum(deviations.prod(axis=1), 1e-12)
        correlation = np.clip(both / product, -1.0, 1.0)
        spread.append(np.column_stack([np.minimum(deviations, _MOST_M), correlation]))
        kind.append(body["class_id"])
    if not keys:
        return np.zeros(0, np.uint64), {}
    columns = {"velocity": velocity, "spread": spread, "kind": kind}
    return np.concatenate(keys), {name: np.concatenate(parts) for name, parts in columns.items()}


#: Of deflate: higher levels take four times as long and save less than a tenth.
_LEVEL = 6
_LIMIT = 1 << 31


class Packer:
    """Columns on their way into a block."""

    def __init__(self) -> None:
        self.entries: list[dict[str, Any]] = []
        self._planes: list[bytes] = []

    def add(self, name: str, values: NDArray[Any], *, scale: float = 1.0, differences: bool = True) -> None:
        """Add a column.

        values: any shape, finite; read back as round(values / scale) * scale, in row order
        scale:  resolution, in the unit of the values
        differences: store each number's difference from the one before
        Raises ValueError if a number does not fit into 31 bits.
        """
        rounded = np.rint(np.asarray(values, np.float64).ravel() / scale)
        if not np.isfinite(rounded).all() or (len(rounded) and np.abs(rounded).max() >= _LIMIT // 2):
            raise ValueError(f"{name}: expected finite numbers below {scale * _LIMIT / 2:g}")
        whole = rounded.astype(np.int64)
        steps = np.diff(whole, prepend=0) if differences else whole
        folded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4")
        width = next(size for size in (1, 2, 3, 4) if not len(folded) or int(folded.max()) < 1 << (8 * size))
        planes = folded.view(np.uint8).reshape(-1, 4)[:, :width]
        self._planes.append(np.ascontiguousarray(planes.T).tobytes())
        entry = {"name": name, "rows": len(whole), "width": width, "scale": scale, "differences": differences}
        self.entries.append(entry)

    def block(self, header: dict[str, Any]) -> bytes:
        """The compressed block: length of the header, header as JSON, planes."""
        text = json.dumps({**header, "columns": self.entries}, separators=(",", ":"), allow_nan=False).encode()
        return zlib.compress(struct.pack("<I", len(text)) + text + b"".join(self._planes), _LEVEL)
