"""Doing to one message's objects what the targets ask for. Pure, and independent of the order of the rows."""

from __future__ import annotations

import numpy as np

from mast_zenoh.attacks.targets import Changes, Tampering, Targets
from mast_zenoh.states import Ints, ObjectStates


def apply(
    targets: Targets, inserted: ObjectStates, objects: ObjectStates, order: Ints, remove_row: Ints, move_row: Ints
) -> Tampering:
    """Insert, hide and displace objects of a victim, all in the world frame.

    targets:    where they are now
    inserted:   false objects as they are to be shown; their ids are the numbers of the targets
    objects:    the victim's n objects, in canonical order
    order:      (n,) the row of the message that each of them is
    remove_row, move_row: by target, the row of `objects` that it is, -1 for none; no row twice
    """
    hides, moves = remove_row >= 0, move_row >= 0
    hidden, displaced = remove_row[hides], move_row[moves]
    before = objects.select(displaced)
    moved = before
    if len(displaced):
        moved = before.with_(position=before.position + targets.move_offset[moves])
    keep = np.ones(len(objects), bool)
    keep[order[hidden]] = False
    numbers = [inserted.id, targets.remove.id[hides], targets.move.id[moves]]
    return Tampering(
        keep=keep,
        moved_index=order[displaced],
        moved=moved,
        added=inserted,
        report=Changes.of(inserted, objects.select(hidden), before, moved, numbers),
        targets=targets,
    )
