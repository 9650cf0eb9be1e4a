"""Life cycle of a set of targets: selection, propagation, reselection."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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

_UNUSED = np.random.default_rng(0)  # for models without random numbers: creating a stream is slow


def check_start(start_s: float) -> None:
    """Raise ValueError for a start before the start of the scene."""
    if not 0.0 <= start_s < np.inf:
        raise ValueError(f"start_s: found {start_s}, expected 0 or more")


class Campaign:
    """Selects and propagates targets for an uncoordinated adversary or a coordinator.

    There are no targets before `start_s` seconds of scene time. New ones are selected every `reselect_every_s` seconds
    (None: never), and with `Selection.until_found` in every frame until there is one.
    Random streams: (seed, scene, name, "selection" | "propagation", frame).
    counts: number of objects selected to be hidden or moved, of false objects placed, and of false objects wanted

    Raises ValueError for an interval that is not positive, and for a start before the start of the scene.
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
        """Set the random streams, named by (seed, scene, name, purpose, frame)."""
        self._seed, self._scene, self._name = seed, scene, name

    def begin(self, frame: int, time_ns: int, scene: Callable[[], tuple[ObjectStates, Coverage]]) -> Targets | None:
        """The targets at `time_ns`, None before the start.

        scene: called if new targets are due, for objects as in `Selection.view`, and the coverage
        """
        if time_ns < self._start_ns:
            return None
        if self.due(time_ns):
            chosen = self._selection.select(*scene(), self._stream("selection", frame))
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
            stored = self._targets
            targets = replace(stored, remove=propagate(stored.remove, elapsed), move=propagate(stored.move, elapsed))
        rng = self._stream("propagation", frame) if self._propagation.draws else _UNUSED
        add = self._propagation.advance(targets.add, elapsed, age, rng)
        return replace(targets, add=add, time_ns=time_ns)

    def store(self, targets: Targets, time_ns: int) -> None:
        """Store the current targets, after they have followed their objects."""
        self._targets, self._time_ns = targets, time_ns

    def due(self, time_ns: int) -> bool:
        """Whether new targets are due at a time."""
        if time_ns < self._start_ns:
            return False
        if self._selected_ns is None:
            return True
        return self._every_ns is not None and time_ns - self._selected_ns >= self._every_ns

    def _stream(self, purpose: str, frame: int) -> np.random.Generator:
        return stream(self._seed, self._scene, self._name, purpose, frame)


def shortfall(counts: Mapping[str, int]) -> str:
    """Describe the targets that could not be found or placed; "" if none.

    counts: see `Campaign.counts`
    """
    if not counts:
        return ""
    if counts["wanted"] > counts["placed"]:
        return f"no place for {counts['wanted'] - counts['placed']} of {counts['wanted']} false objects in its region"
    return "" if counts["selected"] or counts["placed"] else "no target was found"
