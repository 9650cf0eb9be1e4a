"""A simulation by SUMO, in a process of its own: what it is given, and what is there, step by step.

SUMO parses with entities, follows includes, and writes files that its inputs name. So it never opens a user's file: it
reads copies that hold known elements alone, with the line numbers of their originals.
"""

from __future__ import annotations

import contextlib
import difflib
import importlib.util
import math
import os
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import IO, Annotated, Any, BinaryIO, NamedTuple
from xml.sax.saxutils import quoteattr
from xml.sax.xmlreader import AttributesImpl

import msgpack
import numpy as np
from msgspec import Meta

from mast_datasets.files import Element, XmlHandler, read_xml
from mast_datasets.sumo_files import VehicleType, type_of_class
from mast_datasets.sumo_process import MAX_MESSAGE
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.errors import ConfigurationError, SceneError, nearest
from mast_zenoh.scenes.own_detections import MAX_COORDINATE_M, MAX_SIZE_M

#: Roots of configurations.
ROOTS = ("configuration", "sumoConfiguration")
#: Bytes of one file, unpacked.
MAX_BYTES = 200_000_000
_MAX_FILES = 100
_MAX_VALUE = 200  # characters of an option
_MAX_DEPTH = 20
_Begin = Annotated[float, Meta(ge=0, le=1e7)]  # s
_Scale = Annotated[float, Meta(ge=0, le=1000)]  # of the demand: SUMO prepares each vehicle that waits
_SECTIONS_LEFT_OUT = ("output", "report", "gui_only")
_FILES = {"net-file": "net", "route-files": "routes", "additional-files": "additional"}
#: Options that decide about the traffic.
_PASSED = """begin scale max-depart-delay route-steps extrapolate-departpos eager-insert sloppy-insert
random-depart-offset ignore-route-errors ignore-accidents ignore-junction-blocker default.carfollowmodel
default.speeddev default.emergencydecel time-to-impatience pedestrian.model junction-taz routing-algorithm
weights.random-factor tls.actuated.jam-threshold tls.actuated.detector-length device.rerouting.probability
device.rerouting.period device.rerouting.adaptation-interval device.rerouting.adaptation-steps
step-method.ballistic"""
#: Options that are switched off by 0 or less, and what they switch on, which is not supported.
_NOT_SUPPORTED = {
    "lateral-resolution": "sublanes",
    "lanechange.duration": "gradual changes of lanes",
    "default.action-step-length": "steps without an action",
}
#: Beginnings of options that the scene sets itself, or that decide about messages and pictures.
_OWN = ("end", "step-length", "seed", "random", "time-to-teleport", "collision.", "xml-validation", "no-", "verbose")
#: Elements that are copied, of all kinds of files: SUMO does not tell them apart either.
_COPIED = """location type restriction edge lane neigh stopOffset junction request connection roundabout prohibition
tlLogic phase param WAUT wautSwitch wautJunction vTypeDistribution vType routeDistribution route vehicle trip flow stop
interval carFollowing-Krauss carFollowing-KraussOrig1 carFollowing-PWagner2009 carFollowing-BKerner carFollowing-IDM
carFollowing-IDMM carFollowing-EIDM carFollowing-Wiedemann carFollowing-W99 carFollowing-ACC carFollowing-CACC person
personFlow personTrip walk ride busStop trainStop containerStop access parkingArea space taz tazSource tazSink
variableSpeedSign step rerouter closingReroute closingLaneReroute destProbReroute routeProbReroute parkingAreaReroute"""
#: Elements that only measure, write or draw.
_LEFT_OUT = """poly poi inductionLoop e1Detector instantInductionLoop laneAreaDetector e2Detector entryExitDetector
e3Detector detEntry detExit edgeData laneData edgeRelation timedEvent routeProbe"""
_OPTIONS, _ELEMENTS, _SILENT = (frozenset(words.split()) for words in (_PASSED, _COPIED, _LEFT_OUT))
#: Attributes that name files, and those of pictures.
_NAME_FILES = ("file", "href", "output", "dest")
_OF_PICTURES = ("imgFile", "osgFile", "color", "guiShape")
#: Attributes that are numbers; SUMO takes "nan" and "inf" for numbers, too.
_NUMERIC = """length width height minGap minGapLat maxSpeed maxSpeedLat accel decel emergencyDecel apparentDecel sigma
tau speedFactor speedDev impatience depart departPos departSpeed arrivalPos arrivalSpeed begin end period probability
vehsPerHour speed startPos endPos pos duration minDur maxDur offset"""
_NUMBERS = frozenset(_NUMERIC.split())


class SumoInputs(NamedTuple):
    """A configuration of SUMO.

    path:    of the configuration;  begin_s: s, of the simulation
    options: that decide about the traffic, by name without dashes
    net, routes, additional: files, in the order of the configuration
    """

    path: Path
    begin_s: float
    options: Mapping[str, str]
    net: Path
    routes: Sequence[Path]
    additional: Sequence[Path]

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that SUMO reads copies of."""
        return (self.net, *self.routes, *self.additional)


def read_configuration(path: Path) -> SumoInputs:
    """The configuration in a file of SUMO (.sumocfg).

    Raises SceneError, with file, line and reason, for a file that is none, and for an option that is not supported.
    """
    options: dict[str, str] = {}
    files: dict[str, list[Path]] = {kind: [] for kind in _FILES.values()}
    begin_s = 0.0
    for name, option in _options(path):
        if name in _FILES:
            text = option["value"].text()
            files[_FILES[name]] += [path.parent / part for part in text.replace(",", " ").split()]
        elif name in _OPTIONS:
            value = option["value"]
            if not 0 < len(value.text()) <= _MAX_VALUE or not value.text().isprintable():
                value.fail(f"1 to {_MAX_VALUE} characters")
            if name == "begin":
                begin_s = value.read(_Begin)
            if name == "scale":
                value.read(_Scale)
            options[name] = value.text()
        elif name in _NOT_SUPPORTED:
            if option["value"].read(float) > 0.0:
                reason = f"not supported: {_NOT_SUPPORTED[name]} ({name}), expected a configuration without them"
                raise SceneError(f"{path}: {option.place}: {reason}")
        elif not name.startswith(_OWN):
            misspelt = difflib.get_close_matches(name, _OPTIONS, 1, cutoff=0.8)  # a name far from all is another option
            hint = nearest(name, _OPTIONS) if misspelt else ""
            raise SceneError(f"{path}: {option.place}: option {name} is not supported{hint}")
    if len(files["net"]) != 1:
        raise SceneError(f"{path}: found {len(files['net'])} files in net-file, expected one")
    if sum(map(len, files.values())) > _MAX_FILES:
        raise SceneError(f"{path}: found more than {_MAX_FILES} files, expected at most as many")
    return SumoInputs(path, begin_s, options, files["net"][0], files["routes"], files["additional"])


def _options(path: Path) -> Iterator[tuple[str, Element]]:
    """The options of a configuration by name, whether they are in sections or not."""
    elements = read_xml(path, None, None, 1_000_000)
    root = next(elements)
    if root.tag not in ROOTS:
        root.refuse(f"found this root, expected <{'> or <'.join(ROOTS)}>")
    for element in elements:
        if "value" in element.value:
            yield element.tag, element
        elif element.tag not in _SECTIONS_LEFT_OUT:
            yield from ((name, option) for name in element.value for option in element.several(name))


def copy_input(path: Path, target: BinaryIO) -> None:
    """Write a copy of a file of a network, of routes or of additional objects, with known elements alone.

    Elements that measure, write or draw are left out, and so are parameters outside of traffic lights. Raises
    SceneError, with file, line and reason, for a file that is no XML or is too large, and for any other element.
    """
    for _ in _ElementCopy(path, target).parse(MAX_BYTES):
        pass
    target.flush()


def _is_finite(text: str) -> bool:
    """Whether a text is a finite number, or none, such as "random": then SUMO judges it."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return True


class _ElementCopy(XmlHandler):
    """Writes the elements that it is given by a parser, if they are known."""

    def __init__(self, path: Path, target: BinaryIO) -> None:
        super().__init__(path)
        self._target = target
        self._open: list[str] = []
        self._left_out = 0  # open elements that are left out
        self._written = 1  # lines

    def startElement(self, tag: str, attrs: AttributesImpl) -> None:
        attributes: Mapping[str, str] = dict(attrs.items())
        if self._left_out or tag in _SILENT or (tag == "param" and not self._is_of_lights(attributes)):
            self._left_out += 1
            return
        if len(self._open) >= _MAX_DEPTH:
            self._fail(tag, f"found more than {_MAX_DEPTH} nested elements, expected at most as many")
        if not self._open:
            tag = tag if tag == "net" else "additional"
            attributes = attributes if tag == "net" else {}
        elif tag not in _ELEMENTS:
            self._fail(tag, f"this element is not supported{nearest(tag, _ELEMENTS)}")
        for name, value in attributes.items():
            if name in _NAME_FILES:
                self._fail(tag, f"{name} names a file, expected none: SUMO may not read or write others")
            if name in _NUMBERS and not _is_finite(value):
                self._fail(tag, f"{name}: found {value!r}, expected a finite number")
        self._open.append(tag)
        lines = self.line - self._written
        self._written += lines
        values = [
            f" {name}={quoteattr(value)}"
            for name, value in attributes.items()
            if ":" not in name and not name.startswith("xmlns") and name not in _OF_PICTURES
        ]
        self._target.write(("\n" * lines + f"<{tag}{''.join(values)}>").encode())

    def _is_of_lights(self, attributes: Mapping[str, str]) -> bool:
        """Whether a parameter is one of a traffic light that names no file."""
        return bool(self._open) and self._open[-1] == "tlLogic" and "file" not in attributes.get("key", "").lower()

    def endElement(self, tag: str) -> None:
        if self._left_out:
            self._left_out -= 1
            return
        self._target.write(f"</{self._open.pop()}>".encode())

    def _fail(self, tag: str, reason: str) -> None:
        raise SceneError(f"{self.path}: line {self.line}: <{tag}>: {reason}")


INSTALL = "SUMO is not installed, expected pip install 'mast-zenoh[sumo]'"
_MAX_VEHICLES = 20_000  # at one time; the others wait
_MAX_SHOWN = 600  # characters of SUMO's messages
_MAX_SPEED = 200.0
#: s that requests may take, of which the first reads the network; and all others.
_LIMITS_S, _STEP_S = {"start": 120, "advance": 600}, 60
_GRACE_S = 5.0
#: Colliding cars stay where they are, cars that wait are not moved elsewhere, and nothing is written.
_ALWAYS = (
    *("--collision.action", "warn", "--time-to-teleport", "-1", "--max-num-vehicles", str(_MAX_VEHICLES)),
    *("--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never", "--xml-validation.net", "never"),
)


#: Where a car is moved: its name, the edge of its route, the row of its lane; after each step x, y m of its front, and
#: its angle, degrees clockwise from north.
Move = tuple[str, str, int, Sequence[tuple[float, float, float]]]


class Foe(NamedTuple):
    """Another vehicle on its way to the same place of a junction.

    name: of the other;  distance, foe_distance: m, to the place;  exit, foe_exit: m, until both have left it
    lane: of the junction;  yields: whether the car has to;  is_inside: whether the other is on a junction already
    """

    name: str
    distance: float
    foe_distance: float
    exit: float
    foe_exit: float
    lane: str
    yields: bool
    is_inside: bool


#: What a car has to wait for: foes at the next junctions, and the states of the links at the ends of some lanes.
RightOfWay = tuple[list[Foe], list[list[str]]]


class Present(NamedTuple):
    """What is there.

    names:  of n vehicles and persons
    front:  (n, 2) m, middle of the front bumper, in the axes of the network; of persons their middle
    angle:  (n,) degrees clockwise from north;  speed: (n,) m/s;  person: (n,)
    around: of the cars that were watched
    """

    names: Sequence[str]
    front: Floats
    angle: Floats
    speed: Floats
    person: Bools
    around: dict[str, RightOfWay]


class SumoSimulation:
    """SUMO, from the moment at which its network is loaded until `close`.

    inputs: what it simulates;  seed: of its random numbers;  step_ms: ms, of a step

    shapes: type of each vehicle and person that has been there, by name

    All methods raise SceneError, with SUMO's own words, where it refuses its files or ends. Raises ConfigurationError
    if SUMO is not installed.
    """

    def __init__(self, inputs: SumoInputs, seed: int, step_ms: int) -> None:
        if importlib.util.find_spec("libsumo") is None:
            raise ConfigurationError(f"{inputs.path}: {INSTALL}")
        self.shapes: dict[str, VehicleType] = {}
        self._path = inputs.path
        with contextlib.ExitStack() as opened:
            files = [opened.enter_context(tempfile.TemporaryFile()) for _ in inputs.files]
            for file, path in zip(files, inputs.files, strict=True):
                copy_input(path, file)
            self._places = {
                f"/dev/fd/{file.fileno()}": str(path) for file, path in zip(files, inputs.files, strict=True)
            }
            self._messages: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (it is read while the process lives)
            ours, theirs = Pipe()
            with theirs:
                process = subprocess.Popen(
                    [sys.executable, "-P", str(Path(__file__).with_name("sumo_process.py")), str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    stdout=self._messages,
                    stderr=self._messages,
                    pass_fds=[theirs.fileno(), *(file.fileno() for file in files)],
                    cwd="/",
                )
            self._pipe = ours
            self.close = weakref.finalize(self, _end, process, ours)
            names = iter(self._places)
            arguments = ["--net-file", next(names)]
            for option, paths in (("--route-files", inputs.routes), ("--additional-files", inputs.additional)):
                arguments += [option, ",".join(next(names) for _ in paths)] if paths else []
            for name, value in inputs.options.items():
                arguments += [f"--{name}", value]
            arguments += ["--seed", str(seed), "--step-length", f"{step_ms / 1000:g}", *_ALWAYS]
            self.ask("start", arguments)

    def step(
        self, steps: int, moves: Sequence[Move] = (), watched: Mapping[str, Sequence[str]] | None = None
    ) -> Present:
        """Simulate some steps, and return what is there then.

        moves: of cars that do not drive themselves;  watched: by car, the lanes of which `around` tells
        """
        answer = self.ask("step", steps, list(moves), dict(watched or {}))
        for name, (*size, vehicle_class) in answer["shapes"].items():
            if not all(0.0 < length <= MAX_SIZE_M for length in size):
                expected = f"more than 0 and at most {MAX_SIZE_M:g} m: see its vType"
                raise SceneError(f"{self._path}: {name}: found length, width and height {size}, expected {expected}")
            self.shapes[name] = VehicleType(tuple(size), type_of_class(vehicle_class).class_id)
        names = [*answer["vehicles"], *answer["persons"]]
        state = np.frombuffer(answer["state"]).reshape(-1, 4)
        person = np.arange(len(names)) >= len(answer["vehicles"])
        most = [MAX_COORDINATE_M, MAX_COORDINATE_M, np.finfo(float).max, _MAX_SPEED]
        for row in np.flatnonzero(~(np.abs(state) <= most).all(axis=1)):
            raise SceneError(
                f"{self._path}: {names[row]}: found x, y, angle and speed {state[row].tolist()}, expected finite ones, "
                f"at most {MAX_COORDINATE_M:g} m and {_MAX_SPEED:g} m/s"
            )
        around = {car: _right_of_way(*told) for car, told in answer["around"].items()}
        return Present(names, state[:, :2], state[:, 2], state[:, 3], person, around)

    def around(self, car: str, lanes: Sequence[str]) -> RightOfWay:
        """What a car has to wait for. lanes: at whose ends"""
        return _right_of_way(*self.ask("around", car, list(lanes)))

    def ask(self, method: str, *arguments: Any) -> Any:
        """What a method of `RunningSumo` returns, with lists in place of tuples."""
        limit_s = _LIMITS_S.get(method, _STEP_S)
        try:
            self._pipe.send_bytes(msgpack.packb((method, arguments, limit_s), use_bin_type=True))
            if not self._pipe.poll(limit_s + _GRACE_S):
                raise EOFError
            good, answer = msgpack.unpackb(self._pipe.recv_bytes(MAX_MESSAGE), raw=False, strict_map_key=False)
        except (OSError, EOFError):
            code = self.close()
            how = f"took longer than {limit_s} s" if code in (-14, None) else f"ended with exit code {code}"
            raise SceneError(f"{self._path}: SUMO {how}{self._words()}") from None
        if not good:
            raise SceneError(f"{self._path}: SUMO refuses it: {self._named(answer)}{self._words()}")
        return answer

    def _words(self) -> str:
        """What SUMO wrote last, with the names of the user's files."""
        with contextlib.suppress(OSError, ValueError):
            size = self._messages.seek(0, os.SEEK_END)
            self._messages.seek(max(0, size - 4 * _MAX_SHOWN))
            text = self._messages.read().decode(errors="replace")
            lines = [line.strip() for line in text.splitlines() if "pyarrow" not in line]
            words = self._named(" ".join(line for line in lines if line))
            return f": {words[-_MAX_SHOWN:]}" if words else ""
        return ""

    def _named(self, text: str) -> str:
        for descriptor, path in self._places.items():
            text = text.replace(f"'{descriptor}'", f"'{path}'")
        return "".join(filter(str.isprintable, " ".join(text.split())))


def _right_of_way(foes: list[Any], signals: list[list[str]]) -> RightOfWay:
    return [Foe(*foe) for foe in foes], signals


def _end(process: subprocess.Popen[bytes], pipe: Connection) -> int | None:
    """End the process of a simulation; returns its exit code, or None if it had to be killed."""
    pipe.close()
    try:
        return process.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return None
