"""Manipulations of poses: their effects on the objects that an agent reports.

An agent with a false pose reports all objects at wrong positions. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.effects import Effects
from mast_zenoh.effects.message_effects import Spoof
from mast_zenoh.metrics import Manipulations
from mast_zenoh.metrics.manipulations import COLUMNS, MOVED, REMOVED
from mast_zenoh.metrics.record import TruthTable

#: Effects on a pose that leave an agent without its pose, so that it cannot locate objects.
_WITHHELD = ("dropped", "delayed", "corrupted", "unsettled")


def add_pose_manipulations(
    manipulations: Manipulations,
    effects: Effects,
    spoofs: Sequence[Sequence[Spoof]],
    truth: TruthTable,
    agents: Sequence[str],
    frames: Ints,
    min_points: int,
    lasts: int,
) -> Manipulations:
    """Add the objects that an agent misplaces or omits because of a false pose.

    spoofs: by passage of `effects`;  truth: of (f,) frames, of which `agents` are the columns
    min_points: lidar points from which an agent sees an object;  lasts: frames for which it counts after its own
    """
    parts = [manipulations]
    of_frame = frames[truth.boxes.group]
    for index, passage in enumerate(effects.passages):
        if passage.message != "pose" or passage.subject not in agents:
            continue
        culprit = manipulations.culprits.index(passage.node) if passage.node in manipulations.culprits else -1
        seen = truth.points[:, list(agents).index(passage.subject)] >= min_points
        withheld_rows = effects.rows(*_WITHHELD)
        withheld = np.isin(of_frame, effects.frame[withheld_rows[effects.passage[withheld_rows] == index]])
        groups = [((seen & withheld).nonzero()[0], REMOVED, truth.boxes.position)]
        for spoof in spoofs[index]:
            groups.append(((seen & (of_frame == spoof.frame)).nonzero()[0], MOVED, _apparent_positions(spoof, truth)))
        for rows, kind, position in groups:
            n = len(rows)
            parts.append(
                Manipulations(
                    manipulations.culprits,
                    manipulations.reach,
                    manipulations.shown,
                    passage=np.full(n, index),
                    culprit=np.full(n, culprit),
                    kind=np.full(n, kind),
                    frame=of_frame[rows],
                    object=truth.boxes.id[rows],
                    position=position[rows],
                    original=truth.boxes.position[rows],
                    velocity=truth.velocity[rows],
                    lasts=np.full(n, lasts),
                )
            )
    return concatenate_manipulations(parts) if len(parts) > 1 else manipulations


def concatenate_manipulations(parts: Sequence[Manipulations]) -> Manipulations:
    """Concatenate manipulations that share culprits and reach."""
    return Manipulations(
        parts[0].culprits,
        parts[0].reach,
        parts[0].shown,
        *(np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS),
    )


def _apparent_positions(spoof: Spoof, truth: TruthTable) -> Floats:
    """Apparent positions (n, 3) m of objects for an agent with a false pose."""
    rotation = rotation_from_quaternion(spoof.false_rotation) @ rotation_from_quaternion(spoof.rotation).T
    return np.asarray((truth.boxes.position - spoof.position) @ rotation.T + spoof.false_position)
