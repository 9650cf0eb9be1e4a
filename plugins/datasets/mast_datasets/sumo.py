"""Simulated traffic: floating-car data of the simulator SUMO."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mast_datasets.files import find_file
from mast_datasets.sumo_files import (
    MAX_SIZE_M,
    VEHICLE_CLASSES,
    Row,
    VehicleType,
    VehicleTypes,
    read_buildings,
    read_steps,
    sizes,
    type_of_class,
)
from mast_datasets.sumo_traffic import SUFFIXES, SumoTraffic
from mast_datasets.traffic import TrafficScene, busiest_vehicle, check_times, ego_in_traffic, near_route
from mast_datasets.xml_files import has_root
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import SceneBoxes, assemble
from mast_zenoh.scenes.recording import Recording

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
    shortest_s = np.diff(times_ns).min(initial=_NS * 1_000_000) / _NS
    check_times(file, [f"{time / _NS:g} s" for time in times], times_ns, _GAP * shortest_s)
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
        self._rows: list[tuple[int, str, tuple[float, float, float], float, float, VehicleType, bool]] = []
        self._has_heights = False

    def add(self, frame: int, rows: Iterator[tuple[bool, Row]]) -> None:
        """Add the rows of a frame, without those of persons in a vehicle."""
        seen: set[str] = set()
        listed = list(rows)
        vehicles = {_motion(row) for person, row in listed if not person}
        for person, row in listed:
            ride = row.get("vehicle")
            if person and ((ride is not None and ride.value) or _motion(row) in vehicles):
                continue
            name = row["id"]
            if not 0 < len(name.text()) <= _MAX_ID:
                name.fail(f"an id of 1 to {_MAX_ID} characters")
            unique = ("person:" if person else "") + name.value
            if unique in seen:
                name.fail("every id once at a time")
            seen.add(unique)
            if len(self._rows) >= _MAX_ROWS:
                raise SceneError(
                    f"{self._file}: found more than {_MAX_ROWS} rows in the window, expected at most as many; "
                    "choose a shorter duration_s"
                )
            x, y = (row[axis].number(-_MAX_COORDINATE_M, _MAX_COORDINATE_M) for axis in ("x", "y"))
            z = self._height(row)
            speed = row["speed"].number(-_MAX_SPEED, _MAX_SPEED) if "speed" in row else np.nan
            angle = row["angle"].number(-360.0, 720.0)
            yaw = float(np.radians(90.0 - angle))
            self._rows.append((frame, unique, (x, y, z), yaw, speed, self._kind(person, row), person))

    def _height(self, row: Row) -> float:
        """Height m of the road: 0 in a network without heights."""
        if not self._rows:
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
        length, width, height = (row[part].positive(MAX_SIZE_M) for part in ("length", "width", "height"))
        return VehicleType((length, width, height), kind.class_id)

    def trace(self, times_ns: Ints) -> Trace:
        """All rows."""
        frame, name, front, yaw, speed, types, person = zip(*self._rows, strict=True) if self._rows else [()] * 7
        names, number = np.unique(np.array(name, dtype=np.str_), return_inverse=True)
        return Trace(
            times_ns=times_ns,
            frame=np.array(frame, np.int64),
            id=number.astype(np.int64) + 1,
            names=names.tolist(),
            front=np.array(front, np.float64).reshape(-1, 3),
            yaw=np.array(yaw, np.float64),
            speed=np.array(speed, np.float64),
            types=list(types),
            person=np.array(person, bool),
        )


def _motion(row: Row) -> tuple[str, ...]:
    """Position, angle and speed as they are written: SUMO gives those of their vehicle to persons in it."""
    return tuple(row[name].value if name in row else "" for name in ("x", "y", "angle", "speed"))


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
        count = len(trace.times_ns)
        boxes = _boxes(trace)
        ego = busiest_vehicle(boxes, count, file) if self.ego is None else self._find_ego(trace, file)
        own = boxes.select(boxes.id == ego)
        route = own.position[np.argsort(own.frame, kind="stable")]
        origin = route[0] - [0.0, 0.0, own.size[0, 2] / 2]
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


def _boxes(trace: Trace) -> SceneBoxes:
    """The boxes of all objects, in the frame of the network."""
    size = sizes(trace.types)
    ahead: Floats = np.stack([np.cos(trace.yaw), np.sin(trace.yaw), np.zeros(len(trace.yaw))], axis=1)
    back = np.where(trace.person, 0.0, size[:, 0] / 2)
    return SceneBoxes(
        frame=trace.frame,
        id=trace.id,
        position=trace.front - back[:, None] * ahead + np.stack([0 * back, 0 * back, size[:, 2] / 2], axis=1),
        size=size,
        yaw=trace.yaw,
        class_id=np.array([kind.class_id for kind in trace.types], np.uint8),
        velocity=trace.speed[:, None] * ahead,
    )
