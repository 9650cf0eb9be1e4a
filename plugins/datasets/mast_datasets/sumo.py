"""Simulated traffic: floating-car data of the simulator SUMO."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mast_datasets.files import Element, Seconds, find_file, has_root
from mast_datasets.sumo_files import TraceRow, VehicleType, VehicleTypes, read_buildings, read_steps
from mast_datasets.sumo_traffic import SUFFIXES, SumoTraffic
from mast_datasets.traffic import TrafficScene, busiest_vehicle, check_times, ego_in_traffic, ground_below, near_route
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import SceneBoxes, assemble
from mast_zenoh.scenes.recording import Recording

_MAX_ROWS = 2_000_000
_LONGEST_DEFAULT_S = 20.0
_GAP = 1.5  # a step of time longer than this many times the shortest is a gap
_NS = 1_000_000_000
_ENOUGH_M = 10.0  # a trace in which objects move this far in all
_DEGREES = 1e-3  # is in degrees if its positions change by less than this part of it


class Trace(NamedTuple):
    """What is there at F times, in the axes of the network.

    times_ns: (F,) ns, of the simulation
    boxes:    of all objects; their ids are numbers from 1, in the order of their names
    names:    of the objects; that of object k is names[k - 1]
    front:    (N, 3) m, middle of the front bumper of each box, on the ground; for persons their middle
    """

    times_ns: Ints
    boxes: SceneBoxes
    names: list[str]
    front: Floats


def read_trace(file: Path, types: VehicleTypes, start_s: float | None, duration_s: float | None) -> Trace:
    """The rows of a trace from `start_s` (None: the first) on, for `duration_s` (None: to the end, 20 s at most).

    Raises SceneError for a trace that cannot be, and ConfigurationError for a window that is not in it.
    """
    collected, times = _TraceRows(file, types), list[int]()
    begin = None if start_s is None else round(start_s * _NS)
    length = round((_LONGEST_DEFAULT_S if duration_s is None else duration_s) * _NS)
    first = last = None
    for time, rows in read_steps(file):
        now = round(time.read(Seconds) * _NS)
        if last is not None and now <= last:
            time.fail(f"a time later than the one before, {last / _NS:g}")
        first, last = now if first is None else first, now
        begin = now if begin is None else begin
        if now >= begin + length:
            break
        if now >= begin:
            collected.add(len(times), rows)
            times.append(now)
    if first is None or last is None or begin is None:
        raise SceneError(f"{file}: found no time step, expected at least one")
    if not first <= begin <= last:
        expected = f"a time of the trace, {first / _NS:g} to {last / _NS:g}"
        raise ConfigurationError(f"{file}: start_s is {begin / _NS:g}, expected {expected}")
    step = times[-1] - times[-2] if len(times) > 1 else 0
    if duration_s is not None and last + _GAP * step < begin + length:
        most = f"{(last + step - begin) / _NS:g}: the trace ends at {last / _NS:g}"
        raise ConfigurationError(f"{file}: duration_s is {length / _NS:g}, expected at most {most}")
    times_ns = np.array(times, np.int64)
    shortest_s = np.diff(times_ns).min(initial=_NS * 1_000_000) / _NS
    check_times(file, [f"{time / _NS:g} s" for time in times], times_ns, _GAP * shortest_s)
    trace = collected.trace(times_ns)
    _check_metres(file, trace)
    return trace


def _check_metres(file: Path, trace: Trace) -> None:
    """Raise SceneError if positions hardly change although objects move: they are longitudes and latitudes."""
    frame, number = trace.boxes.frame, trace.boxes.id
    order = np.lexsort((frame, number))
    same = (np.diff(number[order]) == 0) & (np.diff(frame[order]) == 1)
    later = order[1:][same]
    seconds = np.diff(trace.times_ns, prepend=0)[frame[later]] / _NS
    stated = float(np.nansum(np.linalg.norm(trace.boxes.velocity[later], axis=1) * seconds))
    moved = float(np.linalg.norm(trace.front[later] - trace.front[order[:-1][same]], axis=1).sum())
    if stated > _ENOUGH_M and moved < stated * _DEGREES:
        raise SceneError(
            f"{file}: positions change by {moved:.3g} m where the speeds add up to {stated:.1f} m, "
            "expected positions in m: write the trace without --fcd-output.geo"
        )


class _TraceRows:
    """Decodes and collects rows."""

    def __init__(self, file: Path, types: VehicleTypes) -> None:
        self._file = file
        self._types = types
        self._rows: list[tuple[int, str, tuple[float, float, float], float, float, VehicleType, bool, bool]] = []

    def add(self, frame: int, listed: list[tuple[bool, Element]]) -> None:
        """Add the rows of a frame, without those of persons in a vehicle."""
        seen: set[str] = set()
        rows = [(person, element, element.read(TraceRow)) for person, element in listed]
        # SUMO gives the position, angle and speed of their vehicle to persons in it.
        vehicles = {(row.x, row.y, row.angle, row.speed) for person, _, row in rows if not person}
        for person, element, row in rows:
            if person and (row.vehicle or (row.x, row.y, row.angle, row.speed) in vehicles):
                continue
            name = ("person:" if person else "") + row.id
            if name in seen:
                element.fail("every id once at a time")
            seen.add(name)
            if (row.z is None) != (self._rows[0][-1] if self._rows else row.z is None):
                element.fail("z for all objects, or for none")
            if len(self._rows) >= _MAX_ROWS:
                most = f"expected at most {_MAX_ROWS}; choose a shorter duration_s"
                raise SceneError(f"{self._file}: found more rows in the window, {most}")
            speed = np.nan if row.speed is None else row.speed
            place, yaw = (row.x, row.y, row.z or 0.0), float(np.radians(90.0 - row.angle))
            kind = self._types.find(element, row, person)
            self._rows.append((frame, name, place, yaw, speed, kind, person, row.z is None))

    def trace(self, times_ns: Ints) -> Trace:
        """The boxes of all rows."""
        columns = zip(*self._rows, strict=True) if self._rows else [()] * 8
        frame, name, place, angle, speed, types, person, _ = columns
        names, number = np.unique(np.array(name, dtype=np.str_), return_inverse=True)
        front, yaw = np.array(place, np.float64).reshape(-1, 3), np.array(angle, np.float64)
        size = np.array([kind.size for kind in types]).reshape(-1, 3)
        ahead: Floats = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))], axis=1)
        back = np.where(np.array(person, bool), 0.0, size[:, 0] / 2)
        middle = front - back[:, None] * ahead + np.stack([0 * back, 0 * back, size[:, 2] / 2], axis=1)
        class_id = np.array([kind.class_id for kind in types], np.uint8)
        velocity = np.array(speed, np.float64)[:, None] * ahead
        numbers = np.array(frame, np.int64), number.astype(np.int64) + 1
        return Trace(times_ns, SceneBoxes(*numbers, middle, size, yaw, class_id, velocity), names.tolist(), front)


_SUFFIXES = (".xml", ".xml.gz", ".csv", ".csv.gz")


@dataclass(kw_only=True, eq=False)
class SumoTrace(TrafficScene):
    """Traffic simulated by SUMO, from its floating-car data (FCD), to which virtual agents are added.

    path:              the trace (.xml or .csv, or either with .gz), or a folder with a single one with "fcd" in its
                       name. Files next to it are read, too: *.poly.xml for buildings and, if the trace contains no
                       sizes, *.rou.xml and *.add.xml for vehicle types
    start_s:           time of the first frame, as in the trace; None: its first
    duration_s:        of the scene; None: to the end of the trace, 20 s at most
    ego:               name of the vehicle that is the ego; None: the one with the most others within 50 m
    radius_m:          objects are there while they are within this distance of any point of the ego's route, 20 to 2000
    building_height_m: of the outlines of buildings without a height

    SUMO's position is the middle of the front bumper, and its angle is in degrees clockwise from north ("FCDOutput" in
    its documentation); a box is half its length behind that, and its yaw is 90 degrees minus the angle. Velocities are
    the speed along the yaw, because a change of lanes may be a jump of positions. The world's axes are those of the
    network, and its origin is below the middle of the ego in the first frame. What an agent sees comes from ray
    casting.
    """

    short_name = "sumo"
    files = (("*fcd*.xml*",), ("*fcd*.csv*",))

    start_s: float | None = None
    duration_s: float | None = None
    ego: str | None = None
    radius_m: float = 150.0
    building_height_m: float = 12.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check(
            start_s=(0.0, 1e9), duration_s=(0.001, 1e5), radius_m=(20.0, 2000.0), building_height_m=(0.1, 1000.0)
        )

    @classmethod
    def recognises(cls, path: Path) -> bool:
        return super().recognises(path) or has_root(path, "fcd-export") or SumoTraffic.recognises(path)

    @classmethod
    def named(cls, argument: str) -> type[Scene]:
        """SumoTraffic for a configuration of SUMO, which is simulated while it is played."""
        return SumoTraffic if SumoTraffic.recognises(Path(argument)) or argument.endswith(SUFFIXES) else cls

    def inputs(self) -> Sequence[Path]:
        """The folder of the trace."""
        return (self.root.parent if self.root.is_file() else self.root,)

    def record(self, seed: int, frames: int | None) -> Recording:
        file = _find_trace(self.root)
        types = VehicleTypes([*_beside(file, ".rou.xml"), *_beside(file, ".add.xml")])
        trace = read_trace(file, types, self.start_s, self.duration_s)
        count, boxes = len(trace.times_ns), trace.boxes
        ego = busiest_vehicle(boxes, count, file) if self.ego is None else self._find_ego(trace, file)
        route = boxes.position[boxes.rows_of(ego)]
        origin, _ = ground_below(boxes, ego, route)
        boxes = boxes.select(near_route(boxes, route[:, :2], self.radius_m))
        outlines, heights = read_buildings(
            _beside(file, ".poly.xml"), route[:, :2], self.radius_m, self.building_height_m
        )
        boxes = replace(boxes, position=boxes.position - origin)
        ego_path = ego_in_traffic(boxes, ego, count, file, lambda number: trace.names[number - 1])
        return assemble(
            file.name.partition(".")[0],
            trace.times_ns,
            boxes,
            self.agents(boxes, ego_path, file),
            self.detector,
            seed=seed,
            frames=frames,
            buildings=tuple(outline - origin[:2] for outline in outlines),
            building_height=np.array(heights, np.float64),
        )

    def _find_ego(self, trace: Trace, file: Path) -> int:
        if self.ego not in trace.names:
            raise ConfigurationError(
                f"{file}: ego is {self.ego!r}, expected the name of a vehicle in the trace from "
                f"{trace.times_ns[0] / 1e9:g} to {trace.times_ns[-1] / 1e9:g} s, such as {', '.join(trace.names[:10])}"
            )
        return trace.names.index(self.ego) + 1


def _find_trace(path: Path) -> Path:
    if path.is_file() and not path.name.endswith(_SUFFIXES):
        raise SceneError(f"{path}: found another kind of file, expected {', '.join(_SUFFIXES)}")
    what = "traces *fcd*.xml or *fcd*.csv"
    return find_file(path, what, lambda file: "fcd" in file.name.lower() and file.name.endswith(_SUFFIXES))


def _beside(file: Path, suffix: str) -> list[Path]:
    return sorted(other for other in file.parent.iterdir() if other.name.endswith((suffix, suffix + ".gz")))
