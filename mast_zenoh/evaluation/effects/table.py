"""The table of measured effects of all interposers (attacks.parquet), and inserted objects over time.

World frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import NO_TURN, rotation_from_quaternion
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.evaluation.effects.passages import MESSAGE_EFFECTS, PassageMeter
from mast_zenoh.evaluation.effects.rows import UNCHANGED
from mast_zenoh.messages.schemas import text
from mast_zenoh.metrics.causes import KINDS, MOVED
from mast_zenoh.wiring.model import InterposedWire, agent_of

#: All effects, by their code in `Effects`: on objects, then on whole messages.
EFFECTS = KINDS + MESSAGE_EFFECTS
CODE = {name: code for code, name in enumerate(EFFECTS)}

#: m; a smaller displacement does not count as a move.
MIN_MOVE_M = 1e-6


class ReportedPose(NamedTuple):
    """Pose of an agent.

    position (3,) m; rotation (4,): active quaternion w x y z, agent to world
    """

    position: Floats
    rotation: Floats


_UNKNOWN_POSE = ReportedPose(np.full(3, np.nan), NO_TURN)

#: Poses by agent and frame.
Poses = Mapping[tuple[str, int], ReportedPose]


@dataclass(frozen=True, slots=True)
class Effects:
    """n effects, sorted by passage, frame, sequence number and effect.

    Missing values are NaN, -1 or "".
    passages: the passages of the run
    passage:  (n,) row of `passages`
    code:     (n,) index into EFFECTS
    frame, seq: (n,) of the message
    step:     (n,) frame of the run in which the interposer received it
    id:       (n,) of the object in the message
    before, after: (n, 3) m, world frame: the object's position in the received and in the sent message
    velocity: (n, 3) m/s, world frame: as sent, or as received for a removed object
    whole:    (n,) bool: an object of a message that was withheld, delayed, forged or reframed as a whole
    frames_late: (n,) delay of the message in frames; 0: on time, or not sent
    time_ns:  (n,) ns, change of the time in the header
    columns:  (n,) str, names of the columns that were changed, separated by spaces
    points:   (n,) of a lidar that make the object; 0: none, as objects of other messages
    """

    passages: tuple[InterposedWire, ...]
    passage: Ints
    code: Ints
    frame: Ints
    seq: Ints
    step: Ints
    id: Ints
    before: Floats
    after: Floats
    velocity: Floats
    whole: np.ndarray
    frames_late: Ints
    time_ns: Ints
    columns: np.ndarray
    points: Ints

    def __len__(self) -> int:
        return len(self.code)

    def until(self, step: float) -> Effects:
        """The effects on messages that interposers received before this frame of the run."""
        kept = self.step < step
        return replace(self, **{name: getattr(self, name)[kept] for name in _EMPTY})

    def rows(self, *effects: str) -> Ints:
        """The rows with these effects."""
        return np.isin(self.code, [CODE[name] for name in effects]).nonzero()[0]


def effects_of(meters: Sequence[PassageMeter], poses: Poses) -> Effects:
    """The effects measured by the meters of a run, once they are closed.

    poses: of the agents, for measurements in the frame of a sensor; without a pose, positions are NaN
    """
    parts = [_objects(index, meter, poses) for index, meter in enumerate(meters)]
    parts += [_messages(index, meter) for index, meter in enumerate(meters)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in _EMPTY} if parts else dict(_EMPTY)
    order = np.lexsort([columns[name] for name in ("id", "code", "seq", "frame", "passage")])
    return Effects(
        passages=tuple(meter.passage for meter in meters),
        **{name: column[order] for name, column in columns.items()},
    )


_EMPTY: dict[str, np.ndarray] = {
    **{name: np.zeros(0, np.int64) for name in ("passage", "code", "frame", "seq", "step", "id")},
    **{name: np.zeros((0, 3)) for name in ("before", "after", "velocity")},
    "whole": np.zeros(0, bool),
    "frames_late": np.zeros(0, np.int64),
    "time_ns": np.zeros(0, np.int64),
    "columns": np.zeros(0, object),
    "points": np.zeros(0, np.int64),
}


def _messages(index: int, meter: PassageMeter) -> dict[str, np.ndarray]:
    """The effects on whole messages of one passage."""
    messages, n = meter.effects.messages, len(meter.effects.messages)
    columns: dict[str, np.ndarray] = {"id": np.full(n, -1, np.int64), "passage": np.full(n, index, np.int64)}
    columns["code"] = np.array([CODE[each.effect] for each in messages], np.int64)
    for name in ("frame", "seq", "step", "frames_late", "time_ns"):
        columns[name] = np.array([getattr(each, name) for each in messages], np.int64)
    columns["columns"] = text([" ".join(each.columns) for each in messages])
    no_positions = {name: np.full((n, 3), np.nan) for name in ("before", "after", "velocity")}
    return columns | no_positions | {"whole": np.zeros(n, bool), "points": np.zeros(n, np.int64)}


def _objects(index: int, meter: PassageMeter, poses: Poses) -> dict[str, np.ndarray]:
    """The effects on objects of one passage."""
    objects = meter.effects.objects
    if not objects:
        return dict(_EMPTY)
    times = ("frame", "seq", "step", "frames_late")
    names = (*times, "effect", "columns", "id", "before", "after", "velocity", "whole", "points")
    columns = {name: np.concatenate([getattr(part, name) for part in objects]) for name in names}
    references = np.concatenate([part.references for part in objects], axis=1)
    of_agent = objects[0].of_agent
    agent = agent_of(meter.passage.subject)
    transforms = [_world_transforms(references[side], of_agent, columns["frame"], poses, agent) for side in (0, 1)]
    for name, (origin, rotation) in zip(("before", "after"), transforms, strict=True):
        columns[name] = _rotate(rotation, columns[name]) + origin
    columns["velocity"] = _rotate(transforms[1][1], columns["velocity"])
    displacement = np.abs(columns["after"] - columns["before"]).max(axis=1, initial=0.0)
    code = columns.pop("effect")
    columns["code"] = np.where((code == UNCHANGED) & (displacement > MIN_MOVE_M), MOVED, code)
    columns["passage"] = np.full(len(code), index, np.int64)
    columns["time_ns"] = np.zeros(len(code), np.int64)
    kept = columns["code"] >= 0
    return {name: column[kept] for name, column in columns.items()}


def _world_transforms(
    references: Floats, of_agent: bool, frame_index: Ints, poses: Poses, agent: str
) -> tuple[Floats, Floats]:
    """Origins (k, 3) and rotations (k, 3, 3) to the world frame of k references.

    references: (k, 7) origin m and quaternion
    """
    origin, rotation = references[:, :3], rotation_from_quaternion(references[:, 3:])
    if of_agent:
        agent_poses = [poses.get((agent, frame_number), _UNKNOWN_POSE) for frame_number in frame_index.tolist()]
        pose_rotation = rotation_from_quaternion(np.array([pose.rotation for pose in agent_poses]).reshape(-1, 4))
        pose_position = np.array([pose.position for pose in agent_poses]).reshape(-1, 3)
        origin = pose_position + np.einsum("mij,mj->mi", pose_rotation, origin)
        rotation = pose_rotation @ rotation
    return origin, rotation


def _rotate(rotation: Floats, vectors: Floats) -> Floats:
    """Vectors (n, 3), each rotated by its own rotation (n, 3, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", rotation, vectors))


#: s, longest gap between insertions of the same object.
MAX_GAP_S = 1.0
#: m and m/s; gate for matching objects without ids by predicted position, and its growth per second: before the
#: velocity is known, and after.
NEAR_M, UNKNOWN_MPS, KNOWN_MPS = 1.5, 35.0, 8.0
#: Lower limits of the filter gains for objects without ids: position, velocity.
_MIN_GAINS = 0.3, 0.05
#: Number of frames on either side over which velocities are measured.
SPAN = 4


def insertions(effects: Effects, period_s: float) -> tuple[Ints, Ints, Floats]:
    """Rows, episodes and velocities of the inserted objects of a run.

    Sorted by passage, episode and frame.

    rows:     (n,) rows of `effects`
    episode:  (n,) int64, from 0: the same number for the same object over time
    velocity: (n, 3) m/s, as sent, or, without a velocity, measured over neighbouring frames of the episode

    Within a passage, rows with the same id belong to the same episode if no gap is longer than MAX_GAP_S. Rows without
    ids continue the episode whose object, predicted at constant velocity, is nearest.
    """
    rows = effects.rows("inserted")
    rows = rows[np.isfinite(effects.after[rows]).all(axis=1)]
    gap = max(1, round(MAX_GAP_S / period_s))
    episode = np.full(len(rows), -1, np.int64)
    first = 0
    for passage in np.unique(effects.passage[rows]).tolist():
        in_passage = (effects.passage[rows] == passage).nonzero()[0]
        frame, id_ = effects.frame[rows[in_passage]], effects.id[rows[in_passage]]
        if (id_ >= 0).all():
            label = _by_id(frame, id_, gap)
        else:
            label = _by_motion(frame, effects.after[rows[in_passage]], gap, period_s)
        episode[in_passage] = label + first
        first += int(label.max(initial=-1)) + 1
    order = np.lexsort((effects.frame[rows], episode))
    rows, episode = rows[order], episode[order]
    return rows, episode, _velocity(effects, rows, episode, period_s)


def _by_id(frame: Ints, id_: Ints, gap: int) -> Ints:
    """(n,) labels: rows with the same id and without a longer gap."""
    order = np.lexsort((frame, id_))
    starts = np.ones(len(frame), bool)
    starts[1:] = (np.diff(id_[order]) != 0) | (np.diff(frame[order]) > gap)
    label = np.empty(len(frame), np.int64)
    label[order] = np.cumsum(starts) - 1
    return label


class _TrackedObject:
    """A tracked inserted object: an alpha-beta filter with growing memory.

    Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.5.
    """

    __slots__ = ("frame", "label", "seen", "vx", "vy", "x", "y")

    def __init__(self, label: int, frame: int, x: float, y: float) -> None:
        self.label, self.frame, self.seen = label, frame, 1
        self.x, self.y, self.vx, self.vy = x, y, 0.0, 0.0

    def distance_to(self, frame: int, x: float, y: float, period_s: float) -> float | None:
        """Distance, m, from the predicted position in a frame; None: outside the gate."""
        elapsed = (frame - self.frame) * period_s
        distance = hypot(x - self.x - self.vx * elapsed, y - self.y - self.vy * elapsed)
        gate_growth = UNKNOWN_MPS if self.seen == 1 else KNOWN_MPS + UNKNOWN_MPS / self.seen
        return distance if distance <= NEAR_M + gate_growth * elapsed else None

    def update(self, frame: int, x: float, y: float, period_s: float) -> None:
        """Update the object by a position."""
        elapsed, k = (frame - self.frame) * period_s, self.seen
        alpha = max(2.0 * (2 * k + 1) / ((k + 1) * (k + 2)), _MIN_GAINS[0])
        beta = max(6.0 / ((k + 1) * (k + 2)), _MIN_GAINS[1])
        self.x, self.y = self.x + self.vx * elapsed, self.y + self.vy * elapsed
        off_x, off_y = x - self.x, y - self.y
        self.x, self.y = self.x + alpha * off_x, self.y + alpha * off_y
        self.vx, self.vy = self.vx + beta * off_x / elapsed, self.vy + beta * off_y / elapsed
        self.frame, self.seen = frame, k + 1


def _by_motion(frame: Ints, position: Floats, gap: int, period_s: float) -> Ints:
    """Labels (n,) of rows in frame order, by nearest predicted object.

    The nearest pairs are matched first.
    """
    label = np.full(len(frame), -1, np.int64)
    objects: list[_TrackedObject] = []
    labels = 0
    bounds = np.flatnonzero(np.diff(frame, prepend=-1, append=-1))
    for first, end in pairwise(bounds.tolist()):
        this_frame = int(frame[first])
        positions = position[first:end, :2].tolist()
        objects = [obj for obj in objects if this_frame - obj.frame <= gap]
        pairs = [
            (distance, i, j)
            for i, obj in enumerate(objects)
            for j, (x, y) in enumerate(positions)
            if (distance := obj.distance_to(this_frame, x, y, period_s)) is not None
        ]
        matched: set[int] = set()
        free = dict(enumerate(positions))
        for _, i, j in sorted(pairs):
            if i not in matched and j in free:
                matched.add(i)
                x, y = free.pop(j)
                objects[i].update(this_frame, x, y, period_s)
                label[first + j] = objects[i].label
        for j, (x, y) in free.items():
            objects.append(_TrackedObject(labels, this_frame, x, y))
            label[first + j] = labels
            labels += 1
    return label


def _velocity(effects: Effects, rows: Ints, episode: Ints, period_s: float) -> Floats:
    """Velocities (n, 3) m/s of rows sorted by episode and frame."""
    velocity = effects.velocity[rows].copy()
    unknown = np.isnan(velocity[:, 0])
    if unknown.any():
        n = len(rows)
        bounds = np.flatnonzero(np.diff(episode, prepend=-1, append=-1))
        begin = np.repeat(bounds[:-1], np.diff(bounds))
        end = np.repeat(bounds[1:], np.diff(bounds)) - 1
        earlier = np.maximum(np.arange(n) - SPAN, begin)
        later = np.minimum(np.arange(n) + SPAN, end)
        seconds = (effects.frame[rows[later]] - effects.frame[rows[earlier]]) * period_s
        displacement = effects.after[rows[later]] - effects.after[rows[earlier]]
        measured = np.divide(
            displacement, seconds[:, None], out=np.zeros_like(displacement), where=seconds[:, None] > 0.0
        )
        velocity[unknown] = measured[unknown]
    return velocity
