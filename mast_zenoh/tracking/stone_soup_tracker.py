"""A tracker of the Stone Soup library as an agent's or the command centre's tracker."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import COVARIANCE_ORDER, Detections, Floats, Ints, ObjectStates
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.tracking.association import MeasurementBatch
from mast_zenoh.tracking.base import Tracker
from mast_zenoh.tracking.view import SensorView

#: What to do without Stone Soup.
INSTALL = "Stone Soup is not installed: pip install 'mast-zenoh[stonesoup]'"
#: Components of a Stone Soup `MultiTargetTracker`.
_COMPONENTS = ("initiator", "deleter", "data_associator", "updater")
_KEYS = (*_COMPONENTS, "tracker", "predictor", "state")


@dataclass(kw_only=True, eq=False)
class StoneSoupTracker(Tracker):
    """Runs a tracker of the Stone Soup library; see docs/how-to-stone-soup.md.

    builder: FILE.py:FUNCTION, next to the scenario, that returns the tracker or its components; "": the default tracker
    options: keyword arguments of the function
    position_std_m, vertical_std_m, size_std_m: standard deviation of a detection's horizontal position per axis, of its
        height and of its sizes, unless it has its own covariance
    score: existence probability that is reported for every track
    seed: of the random numbers that Stone Soup's components draw, if any

    Raises ConfigurationError if Stone Soup is not installed.
    """

    builder: str = ""
    options: Mapping[str, Any] | None = None
    position_std_m: float = 0.4
    vertical_std_m: float = 0.2
    size_std_m: float = 0.3
    score: float = 0.95
    seed: int = 0

    def __post_init__(self) -> None:
        deviations = "position_std_m", "vertical_std_m", "size_std_m"
        check("more than 0", **{name: getattr(self, name) for name in deviations})
        check("more than 0 and less than 1", score=self.score)
        self._variance = np.square([self.position_std_m] * 2 + [self.vertical_std_m] + [self.size_std_m] * 3)
        self._builder, self._options = self.builder, dict(self.options or {})
        self.reset()

    def build(self) -> Any:
        """What the builder returns; a subclass may return its own tracker or components."""
        function = _function(self._builder) if self._builder else _default_builder()
        return function(**self._options)

    def reset(self) -> None:
        stone_soup = _objects()
        self._repeatable = stone_soup.Repeatable.seeded(self.seed)
        with self._repeatable.used():
            built = self.build()
        parts = dict(built) if isinstance(built, Mapping) else {"tracker": built}
        self._state = tuple(parts.pop("state", COVARIANCE_ORDER))
        self._predictor = parts.pop("predictor", None)
        self._tracker = _tracker(parts)
        if not {"x", "y"} <= set(self._state) or len(set(self._state)) < len(self._state):
            raise ValueError(f"state: found {self._state}, expected different names, x and y among them")
        self._time_ns: int | None = None
        self._steps = 0
        self._ids: dict[str, int] = {}
        self._matched = np.zeros(0, np.int64)

    @property
    def matched(self) -> Ints:
        return self._matched

    def step(self, time_ns: int, detections: Detections, view: SensorView | None = None) -> ObjectStates:
        return self._step(time_ns, MeasurementBatch.detections(detections, self._variance), detections.score)

    def step_states(self, time_ns: int, measured: ObjectStates) -> ObjectStates:
        return self._step(time_ns, MeasurementBatch.states(measured), measured.score)

    def _step(self, time_ns: int, measured: MeasurementBatch, score: Floats) -> ObjectStates:
        if self._time_ns is not None and time_ns < self._time_ns:
            raise ValueError(f"time_ns of a step: found {time_ns}, expected at least {self._time_ns}, the previous one")
        self._time_ns = time_ns
        self._steps += 1
        stone_soup = _objects()
        time = stone_soup.timestamp(time_ns)
        with self._repeatable.used():
            detections = stone_soup.detections_of(time_ns, self._steps, measured, score[measured.row], self._state)
            self._tracker.update_tracker(time, set(detections))
            tracks = self._numbered(list(self._tracker.tracks))
            estimates = [
                track.state if self._predictor is None or track.timestamp == time
                else self._predictor.predict(track.state, timestamp=time)
                for track in tracks
            ]  # fmt: skip
        self._matched = stone_soup.matched_rows(tracks, self._steps)
        ids = np.array([self._ids[track.id] for track in tracks], np.int64)
        states: ObjectStates = stone_soup.object_states(tracks, estimates, ids, self._state, self.score)
        return states

    def _numbered(self, tracks: list[Any]) -> list[Any]:
        """The tracks in order of their ids; new ones get the next ids, in order of their state vectors."""
        born = [track for track in tracks if track.id not in self._ids]
        for track in sorted(born, key=lambda track: tuple(np.ravel(track.mean).tolist())):
            self._ids[track.id] = len(self._ids)
        return sorted(tracks, key=lambda track: self._ids[track.id])


def _objects() -> ModuleType:
    """The module that converts objects; raises ConfigurationError if Stone Soup is not installed."""
    try:
        from mast_zenoh.tracking import stone_soup_objects
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "stonesoup":
            raise
        raise ConfigurationError(INSTALL) from None
    return stone_soup_objects


def _default_builder() -> Callable[..., dict[str, Any]]:
    from mast_zenoh.tracking.stone_soup_default import build

    return build


def _tracker(parts: Mapping[str, Any]) -> Any:
    """The tracker that a builder returned, or a new one of the components that it returned."""
    for key in parts:
        if key not in _KEYS:
            raise ValueError(f"builder: returned {key!r}{nearest(key, _KEYS)}")
    if "tracker" in parts:
        tracker = parts["tracker"]
        if not hasattr(tracker, "update_tracker") or len(parts) > 1:
            raise ValueError(
                f"builder: returned {_kinds(parts)}, expected one Stone Soup tracker or {', '.join(_COMPONENTS)}"
            )
        return tracker
    if missing := [name for name in _COMPONENTS if parts.get(name) is None]:
        raise ValueError(f"builder: returned no {', '.join(missing)}, expected {', '.join(_COMPONENTS)}, or a tracker")
    from stonesoup.tracker.simple import MultiTargetTracker

    return MultiTargetTracker(detector=None, **parts)


def _kinds(parts: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}={type(value).__name__}" for key, value in parts.items())


def _function(builder: str) -> Callable[..., Any]:
    """The function of a builder, in a file that the scenario has loaded."""
    file, _, name = builder.rpartition(":")
    path = str(Path(file).resolve())
    modules: Sequence[Any] = list(sys.modules.values())
    loaded = [module for module in modules if getattr(module, "__file__", None) == path]
    function: Callable[..., Any] | None = getattr(loaded[-1], name, None) if loaded else None
    if not callable(function):
        raise ValueError(f"builder: found {builder!r}, expected FILE.py:FUNCTION of a file next to the scenario")
    return function
