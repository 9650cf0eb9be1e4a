"""Doing to one message's objects what the targets ask for. Pure, and independent of the order of the rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.geometry import within_range
from mast_zenoh.arrays.matching import greedy
from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.ordering import canonical_order
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.attacks.imitation import typical
from mast_zenoh.attacks.targets import Changes, Tampering, Targets


def alter(
    objects: ObjectStates,
    *,
    insert: ObjectStates | None = None,
    hide: Sequence[int] = (),
    move: Sequence[int] = (),
    offset: Floats | None = None,
) -> Tampering:
    """The tampering of an attack that knows what it wants: insert objects, hide rows, move rows by `offset` (k, 3) m.

    The changes are reported with the numbers 0, 1, … as targets: inserted, then hidden, then moved.
    """
    hidden, moved = np.asarray(hide, np.int64), np.asarray(move, np.int64)
    targets = Targets(
        ObjectStates.empty() if insert is None else insert,
        objects.select(hidden),
        objects.select(moved),
        np.zeros((len(moved), 3)) if offset is None else offset,
    ).numbered(0)
    return carry_out(targets, targets.add, objects, np.arange(len(objects)), hidden, moved)


def apply(
    targets: Targets,
    objects: ObjectStates,
    agent_position: Floats,
    *,
    max_range_m: float = 70.0,
    assign_radius_m: float = 6.0,
) -> Tampering:
    """Insert, hide and displace objects of a victim at `agent_position` (3,) m, all in the world frame.

    For attacks that know at each message where their targets are. False objects farther than `max_range_m` from the
    victim (bird's-eye view) wait. Each target to hide or displace takes the nearest object within `assign_radius_m`:
    the nearest pair first, no object twice. False objects get the covariance and the score that are typical here.
    """
    order = canonical_order(objects)
    seen = objects.select(order)
    believed = np.concatenate([targets.remove.position, targets.move.position])
    i, j, dx, dy = neighbours(believed, seen.position, np.full(len(believed), assign_radius_m))
    chosen = greedy(i, j, dx * dx + dy * dy)
    row = np.full(len(believed), -1, np.int64)
    row[i[chosen]] = j[chosen]
    inserted = targets.add.select(within_range(targets.add.position, agent_position, max_range_m))
    n = len(targets.remove)
    return carry_out(targets, typical(inserted, seen), seen, order, row[:n], row[n:])


def carry_out(
    targets: Targets, inserted: ObjectStates, objects: ObjectStates, order: Ints, remove_row: Ints, move_row: Ints
) -> Tampering:
    """Insert, hide and displace objects that have been found among those of a victim, all in the world frame.

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
