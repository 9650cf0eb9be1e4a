"""Positions of all objects in SUMO's floating-car data, within a window of time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.sumo.steps import Row, read_steps
from mast_zenoh.scenes.sumo.vehicle_types import VEHICLE_CLASSES, VehicleType, VehicleTypes, positive, type_of_class

_MAX_ROWS = 2_000_000
_MAX_COORDINATE_M = 1e8
_MAX_SPEED = 200.0
_MAX_TIME_S = 1e9
_MAX_ID = 200  # characters
_LONGEST_DEFAULT_S = 20.0
_GAP = 1.5  # a step of time longer than this many times the shortest is a gap
_NS = 1_000_000_000
_ENOUGH_M = 10.0  # a trace in which objects move this far in all
_DEGREES = 1e-3  # is in degrees if its positions change by less than this part of it


@dataclass(frozen=True, eq=False)
class Trace:
    """N rows of a trace, at F times.

    times_ns: (F,) ns, of the simulation
    frame:    (N,) row of `times_ns`
    id:       (N,) number of the object, from 1, in the order of their names
    names:    names of the objects; that of object k is names[k - 1]
    front:    (N, 3) m, middle of the front bumper, on the ground; for persons their middle
    yaw:      (N,) rad, counter-clockwise from x
    speed:    (N,) m/s along the yaw; NaN: not in the trace
    types:    of each row
    person:   (N,) whether it is a person
    """

    times_ns: Ints
    frame: Ints
    id: Ints
    names: list[str]
    front: Floats
    yaw: Floats
    speed: Floats
    types: list[VehicleType]
    person: Bools


def read_trace(file: Path, types: VehicleTypes, start_s: float | None, duration_s: float | None) -> Trace:
    """The rows of a trace from `start_s` (None: the first) on, for `duration_s` (None: to the end, 20 s at most).

    Raises SceneError for a trace that cannot be, and ConfigurationError for a window that is not in it.
    """
    steps = read_steps(file)
    collected = _Rows(file, types)
    times: list[int] = []
    last: int | None = None
    begin = None if start_s is None else round(start_s * _NS)
    length = round((_LONGEST_DEFAULT_S if duration_s is None else duration_s) * _NS)
    for time, rows in steps:
        now = round(time.number(0.0, _MAX_TIME_S) * _NS)
        if last is not None and now <= last:
            time.fail(f"a time later than the one before, {last / _NS:g}")
        last = now
        begin = now if begin is None else begin
        if not times and now > begin:
            raise ConfigurationError(
                f"{file}: start_s is {begin / _NS:g}, expected a time of the trace such as {now / _NS:g}"
            )
        if now >= begin + length:
            break
        if now >= begin:
            collected.add(len(times), rows)
            times.append(now)
    else:
        _check_end(file, times, last, begin, None if duration_s is None else length)
    times_ns = np.array(times, np.int64)
    _check_gaps(file, times_ns)
    trace = collected.trace(times_ns)
    _check_metres(file, trace)
    return trace


def _check_end(file: Path, times: list[int], last: int | None, begin: int | None, length: int | None) -> None:
    """Raise an error for a trace that ends before its window."""
    if last is None or begin is None:
        raise SceneError(f"{file}: found no time step, expected at least one")
    if not times:
        raise ConfigurationError(f"{file}: start_s is {begin / _NS:g}, the trace ends at {last / _NS:g}")
    step = times[-1] - times[-2] if len(times) > 1 else 0
    if length is not None and last + _GAP * step < begin + length:
        raise ConfigurationError(
            f"{file}: duration_s is {length / _NS:g}, expected at most {(last + step - begin) / _NS:g}: "
            f"the trace ends at {last / _NS:g}"
        )


def _check_gaps(file: Path, times_ns: Ints) -> None:
    steps = np.diff(times_ns)
    if len(steps) and steps.max() > _GAP * steps.min():
        place = int(steps.argmax())
        before, after = times_ns[place] / _NS, times_ns[place + 1] / _NS
        raise SceneError(
            f"{file}: found no time step between {before:g} and {after:g}, expected one every {steps.min() / _NS:g} s"
        )


def _check_metres(file: Path, trace: Trace) -> None:
    """Raise SceneError if positions hardly change although objects move: they are longitudes and latitudes."""
    order = np.lexsort((trace.frame, trace.id))
    same = (np.diff(trace.id[order]) == 0) & (np.diff(trace.frame[order]) == 1)
    later = order[1:][same]
    seconds = np.diff(trace.times_ns, prepend=0)[trace.frame[later]] / _NS
    stated = float(np.nansum(np.abs(trace.speed[later]) * seconds))
    moved = float(np.linalg.norm(trace.front[later] - trace.front[order[:-1][same]], axis=1).sum())
    if stated > _ENOUGH_M and moved < stated * _DEGREES:
        raise SceneError(
            f"{file}: positions change by {moved:.3g} m where the speeds add up to {stated:.1f} m, "
            "expected positions in m: write the trace without --fcd-output.geo"
        )


class _Rows:
    """Decodes and collects rows."""

    def __init__(self, file: Path, types: VehicleTypes) -> None:
        self._file = file
        self._types = types
        self._known: dict[str, VehicleType] = {}
        self._frame: list[int] = []
        self._id: list[str] = []
        self._numbers: list[tuple[float, float, float, float, float]] = []
        self._kinds: list[VehicleType] = []
        self._person: list[bool] = []
        self._has_heights = False

    def add(self, frame: int, rows: Iterator[tuple[bool, Row]]) -> None:
        """Add the rows of a frame."""
        seen: set[str] = set()
        for person, row in rows:
            name = row["id"]
            if not 0 < len(name.text()) <= _MAX_ID:
                name.fail(f"an id of 1 to {_MAX_ID} characters")
            unique = ("person:" if person else "") + name.value
            if unique in seen:
                name.fail("every id once at a time")
            seen.add(unique)
            if len(self._frame) >= _MAX_ROWS:
                raise SceneError(
                    f"{self._file}: found more than {_MAX_ROWS} rows in the window, expected at most as many; "
                    "choose a shorter duration_s"
                )
            x, y = (row[axis].number(-_MAX_COORDINATE_M, _MAX_COORDINATE_M) for axis in ("x", "y"))
            z = self._height(row)
            speed = row["speed"].number(-_MAX_SPEED, _MAX_SPEED) if "speed" in row else np.nan
            angle = row["angle"].number(-360.0, 720.0)
            self._frame.append(frame)
            self._id.append(unique)
            self._numbers.append((x, y, z, np.radians(90.0 - angle), speed))
            self._kinds.append(self._kind(person, row))
            self._person.append(person)

    def _height(self, row: Row) -> float:
        """Height m of the road: 0 in a network without heights."""
        if not self._numbers:
            self._has_heights = "z" in row
        if self._has_heights:
            return row["z"].number(-1e5, 1e5)
        if "z" in row:
            row["z"].fail("z for all objects, or for none")
        return 0.0

    def _kind(self, person: bool, row: Row) -> VehicleType:
        if person and "type" not in row:
            return type_of_class("pedestrian")
        name = row["type"]
        if "length" in row and name.value in VEHICLE_CLASSES:
            self._known[name.value] = type_of_class(name.value)
        if name.value not in self._known:
            self._known[name.value] = self._types.find(name)
        kind = self._known[name.value]
        if "length" not in row:
            return kind
        length, width, height = (positive(row[part]) for part in ("length", "width", "height"))
        return VehicleType((length, width, height), kind.class_id)

    def trace(self, times_ns: Ints) -> Trace:
        """All rows."""
        names, number = np.unique(np.array(self._id, dtype=np.str_), return_inverse=True)
        numbers = np.array(self._numbers, np.float64).reshape(-1, 5)
        return Trace(
            times_ns=times_ns,
            frame=np.array(self._frame, np.int64),
            id=number.astype(np.int64) + 1,
            names=names.tolist(),
            front=numbers[:, :3],
            yaw=numbers[:, 3],
            speed=numbers[:, 4],
            types=self._kinds,
            person=np.array(self._person, bool),
        )
