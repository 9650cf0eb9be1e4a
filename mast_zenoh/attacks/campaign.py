"""The life of a set of targets: chosen at a start time, moved from frame to frame, chosen anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mast_zenoh.arrays.states import ObjectStates, propagate
from mast_zenoh.attacks.coverage import Coverage
from mast_zenoh.attacks.propagation import Propagation
from mast_zenoh.attacks.selection import Selection
from mast_zenoh.attacks.targets import Targets
from mast_zenoh.streams import stream

NANOSECONDS = 1e9

COUNTS = ("selected", "placed", "wanted")

_UNUSED = np.random.default_rng(0)  # for those who draw nothing: to make a stream takes longer than to move the objects


def check_start(start_s: float) -> None:
    """Raises ValueError for a start before the scene begins."""
    if not 0.0 <= start_s < np.inf:
        raise ValueError(f"start_s: found {start_s}, expected 0 or more")


class Campaign:
    """Holds targets over time; the adversary that selects for itself and the coordinator each run one.

    Nothing happens before `start_s` seconds of scene time. Targets are chosen anew every `reselect_every_s` seconds
    (None: never), and with `Selection.until_found` in every frame until there is one.
    Draws come from the streams (seed, scene, name, "selection" | "propagation", frame).
    counts: how many objects were selected to be hidden or moved, how many false ones were placed, and how many wanted

    Raises ValueError for an interval that is not positive, and for a start before the scene.
    """

    def __init__(
        self, selection: Selection, propagation: Propagation, reselect_every_s: float | None, start_s: float
    ) -> None:
        if reselect_every_s is not None and not reselect_every_s > 0.0:
            raise ValueError(f"reselect_every_s: found {reselect_every_s}, expected more than 0, or None")
        check_start(start_s)
        self._selection = selection
        self._propagation = propagation
        self._every_ns = None if reselect_every_s is None else round(reselect_every_s * NANOSECONDS)
        self._start_ns = round(start_s * NANOSECONDS)
        self._selected_ns: int | None = None
        self._targets = Targets.empty()
        self._time_ns = 0
        self._numbers_used = 0
        self.counts = dict.fromkeys(COUNTS, 0)
        self._seed, self._scene, self._name = 0, "", ""

    def bind(self, seed: int, scene: str, name: str) -> None:
        """Name the random streams: all draws are functions of (seed, scene, name, purpose, frame)."""
        self._seed, self._scene, self._name = seed, scene, name

    def begin(self, frame: int, time_ns: int, objects: ObjectStates, coverage: Coverage) -> Targets | None:
        """The targets at `time_ns`; None before the start. `objects` are the selection's view of what is seen."""
        if time_ns < self._start_ns:
            return None
        if self.due(time_ns):
            chosen = self._selection.select(objects, coverage, self._stream("selection", frame))
            targets = chosen.numbered(self._numbers_used)
            self._numbers_used += len(targets)
            placed = len(targets.add)
            wanted = placed if targets.wanted is None else targets.wanted
            for name, count in zip(COUNTS, (len(targets) - placed, placed, wanted), strict=True):
                self.counts[name] += count
            if len(targets) or not self._selection.until_found:
                self._selected_ns = time_ns
            elapsed, age = 0.0, 0.0
        else:
            assert self._selected_ns is not None
            elapsed = (time_ns - self._time_ns) / NANOSECONDS
            age = (self._time_ns - self._selected_ns) / NANOSECONDS
            held = self._targets
            targets = replace(held, remove=propagate(held.remove, elapsed), move=propagate(held.move, elapsed))
        rng = self._stream("propagation", frame) if self._propagation.draws else _UNUSED
        add = self._propagation.advance(targets.add, elapsed, age, rng)
        return replace(targets, add=add, time_ns=time_ns)

    def hold(self, targets: Targets, time_ns: int) -> None:
        """Keep the targets as they are now, after they have followed their objects."""
        self._targets, self._time_ns = targets, time_ns

    def due(self, time_ns: int) -> bool:
        """Whether targets are to be chosen anew at a time."""
        if time_ns < self._start_ns:
            return False
        if self._selected_ns is None:
            return True
        return self._every_ns is not None and time_ns - self._selected_ns >= self._every_ns

    def _stream(self, purpose: str, frame: int) -> np.random.Generator:
        return stream(self._seed, self._scene, self._name, purpose, frame)


def shortfall(counts: Mapping[str, int]) -> str:
    """What an attack with these `Campaign.counts` wanted and did not get, in a sentence; "" for nothing."""
    if not counts:
        return ""
    if counts["wanted"] > counts["placed"]:
        return f"no place for {counts['wanted'] - counts['placed']} of {counts['wanted']} false objects in its region"
    return "" if counts["selected"] or counts["placed"] else "no target was found"
