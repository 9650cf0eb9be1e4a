"""Tampering with the objects of one message, independent of their order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.geometry import within_range
from mast_zenoh.arrays.matching import greedy_matching
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
    """Tamper with explicit rows: insert, hide, or move by `offset` (k, 3) m.

    The changes are reported with the target numbers 0, 1, …: inserted, then hidden, then moved.
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
    """Insert, hide and displace objects of a victim at `agent_position` (3,) m.

    For attacks with targets at known positions; all positions are in the world frame. False objects farther than
    `max_range_m` from the victim (bird's-eye view) are withheld. Each target to hide or displace is matched to the
    nearest object within `assign_radius_m`, nearest pair first. False objects get a typical covariance and score.
    """
    order = canonical_order(objects)
    seen = objects.select(order)
    target_positions = np.concatenate([targets.remove.position, targets.move.position])
    i, j, dx, dy = neighbours(target_positions, seen.position, np.full(len(target_positions), assign_radius_m))
    matches = greedy_matching(i, j, dx * dx + dy * dy)
    row = np.full(len(target_positions), -1, np.int64)
    row[i[matches]] = j[matches]
    inserted = targets.add.select(within_range(targets.add.position, agent_position, max_range_m))
    n = len(targets.remove)
    return carry_out(targets, typical(inserted, seen), seen, order, row[:n], row[n:])


def carry_out(
    targets: Targets, inserted: ObjectStates, objects: ObjectStates, order: Ints, remove_row: Ints, move_row: Ints
) -> Tampering:
    """Insert false objects, and hide and displace matched objects of a victim.

    All positions are in the world frame.
    targets:    the current targets
    inserted:   false objects as they will appear; their ids are the target numbers
    objects:    the victim's n objects, in canonical order
    order:      (n,) the row of each object in the message
    remove_row, move_row: by target, the matched row of `objects`, -1 for none; no row twice
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
