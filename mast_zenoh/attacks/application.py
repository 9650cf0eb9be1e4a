"""Doing to one message's objects what the targets ask for. Pure, and independent of the order of the rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mast_zenoh.attacks.imitation import imitate
from mast_zenoh.attacks.ordering import canonical_order
from mast_zenoh.attacks.targets import Changes, Tampering, Targets
from mast_zenoh.geometry import within_range
from mast_zenoh.states import Floats, Ints, ObjectStates
from mast_zenoh.tracking.neighbours import neighbours

#: Part of the position error that goes into the velocity of a target whose object shows none (an α-β filter, α = 1).
VELOCITY_GAIN = 0.2


def apply(
    targets: Targets,
    objects: ObjectStates,
    agent_position: Floats,
    *,
    max_range_m: float = 70.0,
    assign_radius_m: float = 6.0,
    elapsed_s: float = 0.0,
) -> Tampering:
    """Insert, hide and displace objects of a victim at `agent_position` (3,) m, all in the world frame.

    False objects farther than `max_range_m` from the victim (bird's-eye view) wait. Each target to hide or displace
    takes the nearest object within `assign_radius_m`: nearest pair first, no object twice. It then follows that
    object; one that meets nothing stays where it was propagated to. The targets must hold for the time of
    `objects`; `elapsed_s` is the time since they were last applied (see `follow`).
    """
    order = canonical_order(objects)
    ordered = objects.select(order)
    followed, remove_row, move_row = follow(targets, ordered, assign_radius_m=assign_radius_m, elapsed_s=elapsed_s)

    added = targets.add.select(within_range(targets.add.position, agent_position, max_range_m))
    hidden, displaced = remove_row[remove_row >= 0], move_row[move_row >= 0]
    before = ordered.select(displaced)
    moved = before
    if len(displaced):
        moved = before.with_(position=before.position + targets.move_offset[move_row >= 0])
    keep = np.ones(len(objects), bool)
    keep[order[hidden]] = False
    numbers = [added.id, targets.remove.id[remove_row >= 0], targets.move.id[move_row >= 0]]
    return Tampering(
        keep=keep,
        moved_index=order[displaced],
        moved=moved,
        added=imitate(added, ordered),
        report=Changes.of(added, ordered.select(hidden), before, moved, numbers),
        targets=followed,
    )


def follow(
    targets: Targets, objects: ObjectStates, *, assign_radius_m: float = 6.0, elapsed_s: float = 0.0
) -> tuple[Targets, Ints, Ints]:
    """Bring the targets to hide and displace onto the objects they stand for.

    Returns the targets, and for each row of `remove` and of `move` the row of `objects` it follows, -1 for none.
    A target takes over its object's position and velocity. Objects without a velocity (detections) leave the target
    to estimate one from its own steps of `elapsed_s` seconds, so that it survives missed detections.
    """
    n_remove = len(targets.remove)
    believed = np.concatenate([targets.remove.position, targets.move.position])
    row = nearest_first(believed[:, :2], objects.position[:, :2], assign_radius_m)
    return (
        replace(
            targets,
            remove=_onto(targets.remove, objects, row[:n_remove], elapsed_s),
            move=_onto(targets.move, objects, row[n_remove:], elapsed_s),
        ),
        row[:n_remove],
        row[n_remove:],
    )


def nearest_first(origin: Floats, goal: Floats, radius: float) -> Ints:
    """(k,) for each of (k, 2) origins the row of its goal among (n, 2), -1 for none.

    The nearest pair within `radius` is joined first, then the nearest of those left; equal distances go by row.
    """
    result = np.full(len(origin), -1, np.int64)
    i, j, dx, dy = neighbours(origin, goal, np.full(len(origin), radius))
    nearest = np.lexsort((j, i, dx * dx + dy * dy))
    taken: set[int] = set()
    for a, b in zip(i[nearest].tolist(), j[nearest].tolist(), strict=True):
        if result[a] < 0 and b not in taken:
            result[a] = b
            taken.add(b)
    return result


def _onto(states: ObjectStates, objects: ObjectStates, row: Ints, elapsed_s: float) -> ObjectStates:
    """The states at the rows of `objects` that they follow."""
    met = (row >= 0).nonzero()[0]
    if len(met) == 0:
        return states
    goal = row.take(met)
    position, velocity = states.position.copy(), states.velocity.copy()
    position[met], seen = objects.position.take(goal, 0), objects.velocity.take(goal, 0)
    shows = seen.any(axis=1, keepdims=True)
    if not shows.all():
        estimated = velocity[met]
        if elapsed_s > 0.0:
            estimated = estimated + VELOCITY_GAIN / elapsed_s * (position[met] - states.position[met])
        seen = np.where(shows, seen, estimated)
    velocity[met] = seen
    return states.with_(position=position, velocity=velocity)
