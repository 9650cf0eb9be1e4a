"""Interposers on poses: an agent that is told a false pose shows all that it sees elsewhere. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.effects import Effects
from mast_zenoh.effects.message_effects import Spoof
from mast_zenoh.metrics import Manipulations
from mast_zenoh.metrics.manipulations import MOVED, REMOVED
from mast_zenoh.metrics.record import TruthTable

#: Effects on a pose without which an agent cannot place what it sees.
_WITHHELD = ("dropped", "delayed", "corrupted", "unsettled")


def with_poses(
    done: Manipulations,
    effects: Effects,
    spoofs: Sequence[Sequence[Spoof]],
    truth: TruthTable,
    agents: Sequence[str],
    frames: Ints,
    min_points: int,
    lasts: int,
) -> Manipulations:
    """The manipulations, and those of objects that an agent shows elsewhere, or not at all, because of its pose.

    spoofs: by passage of `effects`;  truth: of (f,) frames, of which `agents` are the columns
    min_points: lidar points with which an agent sees an object;  lasts: frames for which it counts after its own
    """
    parts = [done]
    of_frame = frames[truth.boxes.group]
    for index, passage in enumerate(effects.passages):
        if passage.message != "pose" or passage.subject not in agents:
            continue
        culprit = done.culprits.index(passage.node) if passage.node in done.culprits else -1
        seen = truth.points[:, list(agents).index(passage.subject)] >= min_points
        rows = effects.rows(*_WITHHELD)
        withheld = np.isin(of_frame, effects.frame[rows[effects.passage[rows] == index]])
        pieces = [((seen & withheld).nonzero()[0], REMOVED, truth.boxes.position)]
        for spoof in spoofs[index]:
            pieces.append(((seen & (of_frame == spoof.frame)).nonzero()[0], MOVED, _seen_from(spoof, truth)))
        for at, kind, position in pieces:
            n = len(at)
            parts.append(
                Manipulations(
                    done.culprits,
                    done.reach,
                    passage=np.full(n, index),
                    culprit=np.full(n, culprit),
                    kind=np.full(n, kind),
                    frame=of_frame[at],
                    object=truth.boxes.id[at],
                    position=position[at],
                    velocity=truth.velocity[at],
                    lasts=np.full(n, lasts),
                )
            )
    return joined(parts) if len(parts) > 1 else done


def joined(parts: Sequence[Manipulations]) -> Manipulations:
    """All manipulations of a run in one, the parts sharing culprits and reach."""
    names = ("passage", "culprit", "kind", "frame", "object", "position", "velocity", "lasts")
    return Manipulations(
        parts[0].culprits, parts[0].reach, *(np.concatenate([getattr(part, name) for part in parts]) for name in names)
    )


def _seen_from(spoof: Spoof, truth: TruthTable) -> Floats:
    """(n, 3) m, where objects seem to be to an agent that takes a false pose for its own."""
    turn = rotation_from_quaternion(spoof.false_rotation) @ rotation_from_quaternion(spoof.rotation).T
    return np.asarray((truth.boxes.position - spoof.position) @ turn.T + spoof.false_position)
