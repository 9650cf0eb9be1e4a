"""A simulation by SUMO, in a process of its own: what is there, step by step."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import IO, Any, NamedTuple

import msgpack
import numpy as np

from mast_datasets.sumo_inputs import SumoInputs, copy_input
from mast_datasets.sumo_process import MAX_MESSAGE
from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.errors import ConfigurationError, SceneError

INSTALL = "SUMO is not installed, expected pip install 'mast-zenoh[sumo]'"
_MAX_VEHICLES = 20_000  # at one time; the others wait
_MAX_SHOWN = 600  # characters of SUMO's messages
_MAX_COORDINATE_M = 1e8
_MAX_SPEED = 200.0
_MAX_SIZE_M = 1000.0  # of a vehicle: a train, at most
#: s that a request may take: the first one reads the network, and then the time until the scene begins is simulated.
_LOAD_S, _WARM_UP_S, _STEP_S = 120, 600, 60
_GRACE_S = 5.0
#: Colliding cars stay where they are, cars that wait are not moved elsewhere, and nothing is written.
_ALWAYS = (
    *("--collision.action", "warn", "--time-to-teleport", "-1", "--max-num-vehicles", str(_MAX_VEHICLES)),
    *("--no-step-log", "true", "--no-warnings", "true", "--xml-validation", "never", "--xml-validation.net", "never"),
)


class Move(NamedTuple):
    """Where a car is moved.

    car: its name;  edge, lane: of its route, and row of the lane;
    places: x and y m of its front, and angle, degrees clockwise from north, after each step
    """

    car: str
    edge: str
    lane: int
    places: Sequence[tuple[float, float, float]]


class Foe(NamedTuple):
    """Another vehicle on its way to the same place of a junction.

    name: of the other;  distance, foe_distance: m, to the place;  exit, foe_exit: m, until both have left it
    lane, foe_lane: of the junction;  yields, foe_yields: whether the car, or the other, has to;  is_inside: whether the
    other is on a junction already
    """

    name: str
    distance: float
    foe_distance: float
    exit: float
    foe_exit: float
    lane: str
    foe_lane: str
    yields: bool
    foe_yields: bool
    is_inside: bool


class RightOfWay(NamedTuple):
    """What a car has to wait for: foes at the next junctions, and the states of the links at the ends of some lanes."""

    foes: list[Foe]
    signals: list[list[str]]


@dataclass(frozen=True, eq=False)
class Present:
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


class VehicleShape(NamedTuple):
    """Size m of a vehicle or person, and its class as SUMO names it."""

    size: tuple[float, float, float]
    vehicle_class: str


class SumoSimulation:
    """SUMO, from the moment at which its network is loaded until `close`.

    inputs: what it simulates;  seed: of its random numbers;  step_ms: ms, of a step

    All methods raise SceneError, with SUMO's own words, where it refuses its files or ends. Raises ConfigurationError
    if SUMO is not installed.
    """

    def __init__(self, inputs: SumoInputs, seed: int, step_ms: int) -> None:
        if importlib.util.find_spec("libsumo") is None:
            raise ConfigurationError(f"{inputs.path}: {INSTALL}")
        self.shapes: dict[str, VehicleShape] = {}
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
            self.version = self._ask("start", _LOAD_S, arguments)

    def advance(self, until_s: float) -> None:
        """Simulate up to a time."""
        self._ask("advance", _WARM_UP_S, until_s)

    def step(
        self, steps: int, moves: Sequence[Move] = (), watched: Mapping[str, Sequence[str]] | None = None
    ) -> Present:
        """Simulate some steps, and return what is there then.

        moves: of cars that do not drive themselves;  watched: by car, the lanes of which `around` tells
        """
        answer = self._ask("step", _STEP_S, steps, [tuple(move) for move in moves], dict(watched or {}))
        for name, (*size, vehicle_class) in answer["shapes"].items():
            if not all(0.0 < length <= _MAX_SIZE_M for length in size):
                raise SceneError(
                    f"{self._path}: {name}: found length, width and height {size}, expected more than 0 and at most "
                    f"{_MAX_SIZE_M:g} m: see its vType"
                )
            self.shapes[name] = VehicleShape(tuple(size), vehicle_class)
        names = [*answer["vehicles"], *answer["persons"]]
        state = np.frombuffer(answer["state"]).reshape(-1, 4)
        person = np.arange(len(names)) >= len(answer["vehicles"])
        present = Present(names, state[:, :2], state[:, 2], state[:, 3], person, {})
        for car, (foes, signals) in answer["around"].items():
            present.around[car] = RightOfWay([Foe(*foe) for foe in foes], signals)
        self._check(present)
        return present

    def around(self, car: str, lanes: Sequence[str]) -> RightOfWay:
        """What a car has to wait for. lanes: at whose ends"""
        foes, signals = self._ask("around", _STEP_S, car, list(lanes))
        return RightOfWay([Foe(*foe) for foe in foes], signals)

    def cars(self, names: Sequence[str]) -> list[Any]:
        """Of each vehicle: lane, m along it, edges of its route, row of the present one, factor, greatest speed m/s."""
        return list(self._ask("cars", _STEP_S, list(names)))

    def lanes(self, names: Sequence[str]) -> list[Any]:
        """Of each lane: shape, limit m/s, and (next lane, lane of the junction or "", direction) of each link."""
        return list(self._ask("lanes", _STEP_S, list(names)))

    def keep_lanes(self, car: str, edges: Sequence[str]) -> bool:
        """Give a car a route on which it never changes lanes from now on; returns whether SUMO takes it.

        edges: of the route, from the present one or the next one on
        """
        return bool(self._ask("keep_lanes", _STEP_S, car, list(edges)))

    def _check(self, present: Present) -> None:
        """Raise SceneError for a vehicle that cannot be."""
        bad = ~(np.abs(present.front) <= _MAX_COORDINATE_M).all(axis=1)
        bad |= ~(np.abs(present.speed) <= _MAX_SPEED) | ~np.isfinite(present.angle)
        if bad.any():
            row = int(bad.argmax())
            found = *present.front[row].tolist(), float(present.angle[row]), float(present.speed[row])
            raise SceneError(
                f"{self._path}: {present.names[row]}: found x, y, angle and speed {found}, expected finite ones, at "
                f"most {_MAX_COORDINATE_M:g} m and {_MAX_SPEED:g} m/s"
            )

    def _ask(self, method: str, limit_s: int, *arguments: Any) -> Any:
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


def _end(process: subprocess.Popen[bytes], pipe: Connection) -> int | None:
    """End the process of a simulation; returns its exit code, or None if it had to be killed."""
    pipe.close()
    try:
        return process.wait(_GRACE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return None
