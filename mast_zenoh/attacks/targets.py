"""Targets of an adversary, its tampering, the changes that it reports, and views that agree with its lies.

All positions and velocities are in the world frame. Where an object is hidden, a forged view claims free space; where
one is invented, it claims that something returns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import box_corners
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate, propagate
from mast_zenoh.integrity.views import SweptView

#: The changes to an object, and to a pose or a view; an attack report contains indices into this tuple.
ACTIONS = ("inserted", "removed", "moved", "altered", "reframed")
INSERTED, REMOVED, MOVED, ALTERED, REFRAMED = range(len(ACTIONS))
_KINDS = np.array([INSERTED, REMOVED, MOVED], np.uint8)
#: m; a smaller displacement leaves an object in its place: it is altered, not moved.
UNMOVED_M = 1e-6


@dataclass(frozen=True, slots=True)
class Targets:
    """Intended changes to a victim's objects. The ids are the adversary's own numbers.

    add:         false objects to insert (false positives)
    remove:      real objects to hide (false negatives), at their predicted positions
    move:        real objects to displace (translations), at their predicted positions
    move_offset: (k, 3) m, displacement of each row of `move`
    time_ns:     ns, scene time of the states; None: the frame before they are used
    wanted:      number of false objects drawn at the selection, including objects that could not be placed; None: the
                 number of rows of `add`
    """

    add: ObjectStates
    remove: ObjectStates
    move: ObjectStates
    move_offset: Floats
    time_ns: int | None = None
    wanted: int | None = None

    @classmethod
    def empty(cls, time_ns: int | None = None) -> Targets:
        """Targets without rows."""
        return cls(ObjectStates.empty(), ObjectStates.empty(), ObjectStates.empty(), np.zeros((0, 3)), time_ns)

    def __len__(self) -> int:
        return len(self.add) + len(self.remove) + len(self.move)

    def numbered(self, first: int) -> Targets:
        """The same targets numbered from `first`: inserted, removed, then moved ones."""
        numbers = np.arange(first, first + len(self), dtype=np.int64)
        add, remove, move = np.split(numbers, np.cumsum([len(self.add), len(self.remove)]))
        return replace(
            self, add=self.add.with_(id=add), remove=self.remove.with_(id=remove), move=self.move.with_(id=move)
        )

    def propagated(self, dt: float) -> Targets:
        """All targets moved `dt` seconds along their velocities."""
        add, remove, move = (propagate(states, dt) for states in (self.add, self.remove, self.move))
        return replace(self, add=add, remove=remove, move=move)


@dataclass(frozen=True, slots=True)
class Changes:
    """One row per object changed in a frame: the columns of `attack_report`.

    action:          (n,) uint8, index into ACTIONS
    target:          (n,) int64, the adversary's number of the target
    before_position: (n, 3) m, zero for inserted objects
    after_position:  (n, 3) m, zero for removed objects, and as before for altered ones
    velocity:        (n, 3) m/s, of the object afterwards, or before its removal
    """

    action: NDArray[np.uint8]
    target: Ints
    before_position: Floats
    after_position: Floats
    velocity: Floats

    @classmethod
    def of(
        cls,
        added: ObjectStates,
        removed: ObjectStates,
        before: ObjectStates,
        after: ObjectStates,
        numbers: Sequence[Ints],
    ) -> Changes:
        """The report of inserted, removed and moved or altered (`before`, `after`) objects.

        numbers: of the three kinds in turn
        """
        counts = (len(added), len(removed), len(after))
        action = _KINDS.repeat(counts)
        if len(after):
            stay = np.abs(after.position - before.position).max(axis=1) <= UNMOVED_M
            action[len(action) - len(after) :][stay] = ALTERED
        return cls(
            action=action,
            target=np.concatenate(numbers).astype(np.int64, copy=False),
            before_position=np.concatenate([np.zeros((counts[0], 3)), removed.position, before.position]),
            after_position=np.concatenate([added.position, np.zeros((counts[1], 3)), after.position]),
            velocity=np.concatenate([added.velocity, removed.velocity, after.velocity]),
        )

    @classmethod
    def of_message(cls, before_position: Floats, after_position: Floats) -> Changes:
        """The report of a changed pose or view.

        before_position, after_position: (3,) m, of the agent or of its sensor, as received and as sent
        """
        return cls(
            action=np.array([REFRAMED], np.uint8),
            target=np.array([-1], np.int64),
            before_position=before_position[None],
            after_position=after_position[None],
            velocity=np.zeros((1, 3)),
        )

    def __len__(self) -> int:
        return len(self.action)

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns by name, as in the message `attack_report`."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Tampering:
    """Changes to the n objects of one message.

    keep:        (n,) bool, rows of the message to keep
    moved_index: (m,) int64, rows (all kept) that are displaced or altered, in the order of their targets
    moved:       the m displaced or altered objects
    added:       false objects to append, with ids, covariances and scores like the victim's own
    report:      the changes, for the evaluator
    targets:     the current targets, at the positions of their objects
    """

    keep: Bools
    moved_index: Ints
    moved: ObjectStates
    added: ObjectStates
    report: Changes
    targets: Targets

    @classmethod
    def nothing(cls, n: int, targets: Targets | None = None) -> Tampering:
        """No change to any of the n objects."""
        no_objects = ObjectStates.empty()
        targets = _NO_TARGETS if targets is None else targets
        return cls(np.ones(n, bool), no_objects.id, no_objects, no_objects, _NO_CHANGES, targets)

    @classmethod
    def of(
        cls,
        objects: ObjectStates,
        order: Ints,
        inserted: ObjectStates,
        hidden: Ints,
        changed: Ints,
        before: ObjectStates,
        claims: ObjectStates,
        numbers: Sequence[Ints],
        targets: Targets | None = None,
    ) -> Tampering:
        """Insert false objects, hide some of a victim's objects and change others.

        objects:  the victim's n objects, in canonical order; order: (n,) the row of each in the message
        inserted: false objects as they will appear
        hidden, changed: (h,), (m,) rows of `objects`, none twice
        before, claims: the m changed objects, and the states that replace them
        numbers:  of the targets of the three kinds in turn; targets: None: those of these changes
        """
        removed = objects.select(hidden)
        keep = np.ones(len(objects), bool)
        keep[order[hidden]] = False
        report = Changes.of(inserted, removed, before, claims, numbers)
        if targets is None:
            targets = Targets(inserted, removed, before, claims.position - before.position)
        return cls(keep, order[changed], claims, inserted, report, targets)

    def applied_to(self, objects: ObjectStates) -> ObjectStates:
        """The objects that replace `objects` on the wire: kept rows, then added ones."""
        if len(self.moved_index):
            columns = {name: column.copy() for name, column in objects.columns().items()}
            for name, column in self.moved.columns().items():
                columns[name][self.moved_index] = column
            objects = ObjectStates.from_columns(columns)
        return concatenate([objects if self.keep.all() else objects.select(self.keep), self.added])


_NO_TARGETS = Targets.empty()
_NONE = ObjectStates.empty()
_NO_CHANGES = Changes.of(_NONE, _NONE, _NONE, _NONE, [_NONE.id] * 3)


#: m by which a hidden object is larger than its box, so that its edges are free, too; and by which space is claimed
#: free behind it.
MARGIN_M, BEHIND_M = 0.8, 3.0
#: m; something that returns this far before an object is another object.
BEFORE_M = 2.0
#: m; a smaller displacement leaves an object in its place.
SAME_PLACE_M = 0.5
#: m; nearer to the sensor than this, an object covers no definite directions.
NEAREST_M = 0.5


class ViewForger:
    """Remembers the lies of the newest frame, and forges the view of that frame."""

    def __init__(self) -> None:
        self._frame = -1
        self._lies: list[tuple[ObjectStates, Tampering]] = []

    def remember(self, frame: int, objects: ObjectStates, tampering: Tampering) -> None:
        """Add the lies about the n objects of one message of a frame."""
        if frame != self._frame:
            self._frame, self._lies = frame, []
        self._lies.append((objects, tampering))

    def forge(self, frame: int, swept: SweptView) -> SweptView:
        """The view with the lies of a frame; unchanged for a frame without any."""
        if frame != self._frame:
            return swept
        hidden, invented = [], []
        for objects, tampering in self._lies:
            before, after = objects.select(tampering.moved_index), tampering.moved
            if len(after):
                displaced = np.hypot(*(after.position - before.position)[:, :2].T) > SAME_PLACE_M
                before, after = before.select(displaced), after.select(displaced)
            hidden += [objects.select(~tampering.keep), before]
            invented += [tampering.added, after]
        return blocked(opened(swept, concatenate(hidden)), concatenate(invented))


def opened(swept: SweptView, boxes: ObjectStates) -> SweptView:
    """The view with free space through k boxes, as far as it is free beside them.

    A direction in which something returns before a box stays as it is.
    """
    free = swept.free
    for cells, sectors, near, far in _directions(swept, boxes, MARGIN_M):
        beside = np.flatnonzero(_neighbours(sectors, swept))
        behind = np.full(len(free), far + BEHIND_M)
        if len(beside):
            behind = np.fmax(behind, np.fmax.reduce(free[:, beside], axis=1))  # what is unknown tells nothing
        behind = np.minimum(behind, swept.view.max_range)[:, None]
        changed = cells & (free > near - BEFORE_M)
        free = np.where(changed, np.maximum(free, behind), free)
    return swept if free is swept.free else replace(swept, free=free)


def blocked(swept: SweptView, boxes: ObjectStates) -> SweptView:
    """The view with returns from k boxes: nothing behind their nearest points is free."""
    free = swept.free
    for cells, _, near, _ in _directions(swept, boxes, 0.0):
        free = np.where(cells, np.minimum(free, near), free)
    return swept if free is swept.free else replace(swept, free=free)


def _directions(swept: SweptView, boxes: ObjectStates, margin_m: float) -> Iterator[tuple[Bools, Bools, float, float]]:
    """Of each box in view: its cells (bands, sectors), its sectors (sectors,), and its range from and to, m.

    The cells are those between the outermost directions of its corners. margin_m: by which boxes are larger
    """
    if swept.free.size == 0 or len(boxes) == 0:
        return
    view, (bands, sectors) = swept.view, swept.free.shape
    width, height = view.azimuth_max - view.azimuth_min, view.elevation_max - view.elevation_min
    full = width > 2 * np.pi - 1e-6
    with np.errstate(over="ignore", invalid="ignore"):
        corners = box_corners(boxes.position, boxes.size + 2.0 * margin_m, boxes.yaw)
        points = np.concatenate([boxes.position[:, None], corners], axis=1)
        x, y, z = np.moveaxis((points - view.position) @ view.rotation, -1, 0)
        ground = np.hypot(x, y)
        distance = np.hypot(ground, z)
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, ground)
        turn = (azimuth - azimuth[:, :1] + np.pi) % (2 * np.pi) - np.pi  # from the centre of the box
        centre = (azimuth[:, 0] - view.azimuth_min) % (2 * np.pi)
        centre -= np.where(centre > np.pi + 0.5 * width, 2 * np.pi, 0.0)
        limits = np.stack(
            [
                np.floor((centre + turn.min(axis=1)) * (sectors / width)),
                np.floor((centre + turn.max(axis=1)) * (sectors / width)),
                np.floor((elevation.min(axis=1) - view.elevation_min) * (bands / height)),
                np.floor((elevation.max(axis=1) - view.elevation_min) * (bands / height)),
            ],
            axis=1,
        )
    sector, band = np.arange(sectors), np.arange(bands)
    for row in range(len(boxes)):
        near, far = float(distance[row].min()), float(distance[row].max())
        if not (np.isfinite(limits[row]).all() and np.isfinite(far) and NEAREST_M < near <= view.max_range):
            continue
        first, last, low, high = limits[row].tolist()
        of_sectors = (sector - first) % sectors <= last - first if full else (sector >= first) & (sector <= last)
        of_bands = (band >= low) & (band <= high)
        if of_sectors.any() and of_bands.any():
            yield of_bands[:, None] & of_sectors, of_sectors, near, far


def _neighbours(of_box: Bools, swept: SweptView) -> Bools:
    """The sectors (sectors,) next to those of a box."""
    view = swept.view
    left, right = np.roll(of_box, 1), np.roll(of_box, -1)
    if view.azimuth_max - view.azimuth_min <= 2 * np.pi - 1e-6:
        left[0], right[-1] = False, False
    return (left | right) & ~of_box
