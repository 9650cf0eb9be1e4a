"""Targets of an adversary, its tampering, and the changes that it reports.

All positions and velocities are in the world frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate, propagate

#: The changes to an object, and to a pose or a view; an attack report contains indices into this tuple.
ACTIONS = ("inserted", "removed", "moved", "altered", "reframed")
INSERTED, REMOVED, MOVED, ALTERED, REFRAMED = range(len(ACTIONS))
_KINDS = np.array([INSERTED, REMOVED, MOVED], np.uint8)


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
        """The report of inserted, removed and moved (`before`, `after`) objects.

        numbers: of the three kinds in turn
        """
        counts = (len(added), len(removed), len(after))
        return cls(
            action=_KINDS.repeat(counts),
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
