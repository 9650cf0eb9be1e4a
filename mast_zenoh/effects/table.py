"""The table of measured effects of all interposers (attacks.parquet).

World frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.effects.message_effects import MESSAGE_EFFECTS
from mast_zenoh.effects.passages import PassageMeter
from mast_zenoh.effects.rows import UNCHANGED
from mast_zenoh.metrics.manipulations import KINDS, MOVED
from mast_zenoh.wiring.model import Passage
from mast_zenoh.wiring.subjects import agent_of

#: All effects, by their code in `Effects`: on objects, then on whole messages.
EFFECTS = KINDS + MESSAGE_EFFECTS
CODE = {name: code for code, name in enumerate(EFFECTS)}

#: m; a smaller displacement does not count as a move.
MIN_MOVE_M = 1e-6


class Pose(NamedTuple):
    """Pose of an agent.

    position (3,) m; rotation (4,): active quaternion w x y z, agent to world
    """

    position: Floats
    rotation: Floats


_UNKNOWN_POSE = Pose(np.full(3, np.nan), np.array([1.0, 0.0, 0.0, 0.0]))

#: Poses by agent and frame.
Poses = Mapping[tuple[str, int], Pose]


@dataclass(frozen=True, slots=True)
class Effects:
    """n effects, sorted by passage, frame, sequence number and effect.

    Missing values are NaN, -1 or "".
    passages: the passages of the run
    received: for each passage, the number of messages that it received
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
    """

    passages: tuple[Passage, ...]
    received: tuple[int, ...]
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

    def __len__(self) -> int:
        return len(self.code)

    def rows(self, *effects: str, whole: bool | None = None) -> Ints:
        """The rows with these effects.

        whole: None, or the required value of the column `whole`
        """
        chosen = np.isin(self.code, [CODE[name] for name in effects])
        return (chosen if whole is None else chosen & (self.whole == whole)).nonzero()[0]


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
        received=tuple(meter.received for meter in meters),
        **{name: column[order] for name, column in columns.items()},
    )


_EMPTY: dict[str, np.ndarray] = {
    **{name: np.zeros(0, np.int64) for name in ("passage", "code", "frame", "seq", "step", "id")},
    **{name: np.zeros((0, 3)) for name in ("before", "after", "velocity")},
    "whole": np.zeros(0, bool),
    "frames_late": np.zeros(0, np.int64),
    "time_ns": np.zeros(0, np.int64),
    "columns": np.zeros(0, object),
}


def _messages(index: int, meter: PassageMeter) -> dict[str, np.ndarray]:
    """The effects on whole messages of one passage."""
    n = len(meter.effects.messages)
    columns = {name: np.full(n, -1, np.int64) for name in ("id",)} | {"passage": np.full(n, index, np.int64)}
    columns["code"] = np.array([CODE[each.effect] for each in meter.effects.messages], np.int64)
    for name in ("frame", "seq", "step", "frames_late", "time_ns"):
        columns[name] = np.array([getattr(each, name) for each in meter.effects.messages], np.int64)
    columns["columns"] = _texts([" ".join(each.columns) for each in meter.effects.messages])
    no_positions = {name: np.full((n, 3), np.nan) for name in ("before", "after", "velocity")}
    return columns | no_positions | {"whole": np.zeros(n, bool)}


def _objects(index: int, meter: PassageMeter, poses: Poses) -> dict[str, np.ndarray]:
    """The effects on objects of one passage."""
    objects = meter.effects.objects
    if not objects:
        return dict(_EMPTY)
    names = ("frame", "seq", "step", "effect", "columns", "id", "before", "after", "velocity", "whole", "frames_late")
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


def _texts(values: list[str]) -> np.ndarray:
    column = np.empty(len(values), object)
    column[:] = values
    return column
