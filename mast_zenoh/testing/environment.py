"""Checks of what surrounds the algorithms: scenes, detectors, link rules, faults.

A failed check raises AssertionError.

Checks of drivers: limits, determinism, the order of objects, absurd situations, and no shared state.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import CLASSES, Detections, Floats, Ints, ObjectStates
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import ACTIONS
from mast_zenoh.driving import CarLimits, Command, Driver, RouteAhead, Situation
from mast_zenoh.errors import ConfigurationError, MastError
from mast_zenoh.faults.base import Fault
from mast_zenoh.gather import MAX_TRACK_VALUE
from mast_zenoh.links import FATES, Passage, Rule, SenderPose, Sensed
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Detector, LidarSensor
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, expect_finite, expect_same, unchanged

_SENSOR = np.array([20.0, 10.0, 15.0])
_TOLERANCE = 1e-6  # of rotations that data sets give in single precision


def check_scene(scene: Scene, *, frames: int = 3, seed: int = 0) -> None:
    """Check that a scene is repeatable, valid and of the requested length.

    scene:  a new instance; it is copied, and not changed
    frames: how many are recorded, at least 2;  seed: of its random draws
    Raises AssertionError.
    """
    subject = f"{type(scene).__name__}.record"
    first, again, short = (_recorded(scene, seed, n, subject) for n in (frames, frames, 1))
    expect(len(first) <= frames, f"{subject}: found {len(first)} frames, expected at most {frames}")
    expect_same(first, again, f"{subject}: two recordings of one seed differ")
    expect(len(short) == 1, f"{subject}: found {len(short)} frames, expected 1")
    for name in ("id", "position"):
        same = np.array_equal(getattr(first.truth_at(0), name), getattr(short.truth_at(0), name))
        expect(same, f"{subject}: the first frame depends on how many are recorded: truth.{name}")
    _check_recording(subject, first)


def _recorded(scene: Scene, seed: int, frames: int, subject: str) -> Recording:
    recording = copy.deepcopy(scene).record(seed, frames)
    try:
        recording.validate()
    except (MastError, AttributeError, TypeError, ValueError) as error:
        raise AssertionError(f"{subject}: {error}") from error
    return recording


def _check_recording(subject: str, recording: Recording) -> None:
    """Check what `Recording.validate` does not."""
    turned = recording.agent_rotation @ np.swapaxes(recording.agent_rotation, -1, -2)
    right_handed = np.linalg.det(recording.agent_rotation) > 0.0
    sound = np.allclose(turned, np.eye(3), atol=_TOLERANCE) and right_handed.all()
    expect(sound, f"{subject}: agent_rotation has a matrix that is not a rotation")
    expect((recording.truth.size > 0.0).all(), f"{subject}: truth.size has a length that is not greater than 0")
    expect((recording.truth.class_id < len(CLASSES)).all(), f"{subject}: truth.class_id: expected below {len(CLASSES)}")
    expect((recording.points >= 0).all(), f"{subject}: points has negative numbers")
    known: set[int] = set()
    before: list[int] = []  # an object may have left since a sensor measured
    for frame in range(len(recording)):
        ids = recording.truth_at(frame).id.tolist()
        known.update(ids)
        recent, before = (ids if recording.measurements is None else [*ids, *before]), ids
        for column, agent in enumerate(recording.agents):
            rows = range(len(agent.sensors))
            detected = np.concatenate([recording.detection_truth_id_at(frame, column, row) for row in rows])
            unknown = set(detected.tolist()) - {-1, *recent}
            place = f"{subject}: detection_truth_id of {agent.name} in frame {frame}"
            expect(not unknown, f"{place}: no object {min(unknown, default=0)} in this frame")
    for agent in recording.agents:
        there = agent.object_id == -1 or agent.object_id in known
        expect(
            there, f"{subject}: {agent.name}: object_id is {agent.object_id}, which no object has: expected -1 for none"
        )


def check_detector(detector: Detector) -> None:
    """Check that a detector fulfils its contract.

    With zero, one and a thousand objects.

    Raises AssertionError.
    """
    for n in samples.COUNTS:
        subject = f"{type(detector).__name__}.detect with {n} objects"
        objects = samples.states(n)
        points = np.where(np.arange(n) % 3 == 1, 0, np.arange(n) % 90).astype(np.int32)
        with unchanged(subject, objects=objects, points=points, sensor_position=_SENSOR):
            detections, ids = _detected(detector, objects, points)
        expect(isinstance(detections, Detections), f"{subject}: found {type(detections).__name__}, expected Detections")
        count = len(detections), len(ids)
        expect(count[0] == count[1], f"{subject}: {count[0]} detections and {count[1]} ids, expected equal numbers")
        expect_finite(detections, subject)
        expect((np.diff(detections.score) <= 0.0).all(), f"{subject}: the best score is not first")
        expect(((detections.score >= 0.0) & (detections.score <= 1.0)).all(), f"{subject}: a score is not from 0 to 1")
        expect((detections.size > 0.0).all(), f"{subject}: a size is not greater than 0")
        seen = objects.id[points > 0]
        expect(np.isin(ids, np.append(seen, -1)).all(), f"{subject}: detects an object without lidar returns")
        text = f"{subject}: two runs with the same random stream differ"
        expect_same((detections, ids), _detected(detector, objects, points), text)
        order = np.random.default_rng(n).permutation(n)
        shuffled = _detected(detector, objects.select(order), points[order])
        expect_same(_sorted(detections, ids), _sorted(*shuffled), f"{subject}: depends on the order of the rows")


def _detected(detector: Detector, objects: ObjectStates, points: np.ndarray) -> tuple[Detections, Ints]:
    made, random = copy.deepcopy(detector), np.random.default_rng(5)
    return made.detect(objects, points, LidarSensor(), _SENSOR, np.eye(3), 0.0, random)


def _sorted(detections: Detections, ids: Ints) -> tuple[Detections, Ints]:
    """In a canonical order: detections with equal scores may come in any order."""
    order = np.lexsort((*detections.position.T, detections.score, ids))
    return detections.select(order), ids[order]


def check_link_rule(rule: Rule) -> None:
    """Check a link rule with zero, one and a thousand messages.

    It must fulfil what the documentation of `Rule` promises.

    rule: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    subject = type(rule).__name__
    fate = getattr(rule, "fate", None)
    expect(fate in FATES, f"{subject}.fate: found {fate!r}, expected one of {', '.join(FATES)}")
    for n in samples.COUNTS:
        expect(
            _passages(rule, n) == _passages(rule, n), f"{subject}: the results of two copies differ for the same draws"
        )


def _passages(rule: Rule, n: int) -> list[tuple[Passage, ...]]:
    """The passages of n messages through a rule."""
    subject = type(rule).__name__
    rule, random = copy.deepcopy(rule), np.random.default_rng(n)
    rows = rule.sample(random, n)
    expect(len(rows) == n, f"{subject}.sample: found {len(rows)} rows of draws for {n} messages")
    results = []
    for index, row in enumerate(rows.tolist()):
        now = index * samples.PERIOD_NS
        position = np.zeros(3) if rule.needs_position else None
        size = 1000 if rule.needs_size else 0
        message = Passage(now, now, size=size, position=position, referenced=rule.needs_frame, sensed=_sensed(rule))
        copies = rule.apply(message, row) if rule.active(now) else (message,)
        expect(
            isinstance(copies, tuple), f"{subject}.apply: found {type(copies).__name__}, expected a tuple of passages"
        )
        for passage in copies:
            expect(isinstance(passage, Passage), f"{subject}.apply: found {type(passage).__name__}, expected a Passage")
            expect(passage.delay_ns >= message.delay_ns, f"{subject}.apply: a message leaves before it arrives")
            draws = rule.sample_copy(row, random)
            expect(len(draws) == len(row), f"{subject}.sample_copy: found {len(draws)} draws, expected {len(row)}")
        results.append(tuple(passage._replace(position=None, sensed=_comparable(passage)) for passage in copies))
    return results


def _sensed(rule: Rule) -> Sensed | None:
    """Detections for a rule that needs them."""
    if not rule.needs_detections:
        return None
    pose = SenderPose(0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), 0.0)
    return Sensed(samples.detections(3), np.zeros(3), np.eye(3), pose)


def _comparable(passage: Passage) -> Any:
    """The detections of a passage, to compare them with others'."""
    if passage.sensed is None:
        return None
    return tuple(column.tobytes() for column in passage.sensed.detections.columns().values())


def check_fault(fault: Fault) -> None:
    """Check that a fault acts on messages or processes, with valid rules and actions.

    Raises AssertionError.
    """
    subject = type(fault).__name__
    expect(
        fault.over is None or fault.over >= fault.at,
        f"{subject}.over: found {fault.over}, expected {fault.at} or later",
    )
    events = fault.events()
    for lockstep in (True, False):
        rules = fault.rules(lockstep)
        expect(rules or events, f"{subject}: found neither rules nor events, expected one of them")
        expect(rules == fault.rules(lockstep), f"{subject}.rules: two calls return different rules")
        for index, rule in enumerate(rules):
            try:
                registry.build({**rule, "at": fault.at, "until": fault.over}, Rule, f"{subject}.rules[{index}]")
            except ConfigurationError as error:
                raise AssertionError(str(error)) from error
    for time_s, action in events:
        expect(action in ACTIONS, f"{subject}.events: found {action!r}, expected one of {', '.join(ACTIONS)}")
        expect(time_s >= fault.at, f"{subject}.events: {action} at {time_s} s, expected {fault.at} s or later")
    ascending = all(first[0] <= second[0] for first, second in pairwise(events))
    expect(ascending, f"{subject}.events: not sorted by time")


_SIZE: Floats = np.array([4.5, 1.9])
#: What cars can do: those of the shipped world, and a lame one.
_LIMITS = (CarLimits(), CarLimits(acceleration=0.5, braking=1.5, curvature=0.05))
_FRAMES = 4


def check_driver(driver: Driver) -> None:
    """Check that a driver fulfils what the documentation of `Driver` promises.

    In each of many situations, with zero, one and a thousand objects, and with values that no sensor would report, it
    returns a finite command within the limits, leaves its inputs unchanged, and does not depend on the order of the
    objects. Two drivers that are made alike do alike, whatever others drive meanwhile.

    driver: a new instance; it is copied, and not changed
    Raises AssertionError.
    """
    subject = f"{type(driver).__name__}.drive"
    for name, situations in _sequences():
        _check_sequence(driver, f"{subject} {name}", list(situations))


def _check_sequence(driver: Driver, subject: str, situations: list[Situation]) -> None:
    straight, shuffled, beside, other = (copy.deepcopy(driver) for _ in range(4))
    random = np.random.default_rng(0)
    commands = []
    for situation in situations:
        with unchanged(subject, situation=situation):
            command = straight.drive(situation)
        _check_command(subject, command, situation.limits)
        commands.append(command)
        order = random.permutation(len(situation.objects))
        permuted = copy.copy(situation)
        object.__setattr__(permuted, "objects", situation.objects.select(order))
        expect(shuffled.drive(permuted) == command, f"{subject}: depends on the order of the objects")
    for situation, command in zip(situations, commands, strict=True):
        other.drive(_situation(samples.states(3), 3.0))
        expect(
            beside.drive(situation) == command,
            f"{subject}: two instances that are made alike differ: it is not deterministic, or they share state",
        )


def _check_command(subject: str, command: object, limits: CarLimits) -> None:
    expect(
        isinstance(command, Command) and all(isinstance(value, float) for value in command),
        f"{subject}: returned {command!r:.80}, expected a Command of two numbers",
    )
    assert isinstance(command, Command)
    expect(all(map(math.isfinite, command)), f"{subject}: returned {command}, expected finite numbers")
    reason = limits.refusal(command)
    expect(not reason, f"{subject}: returned a command that the car refuses: {reason}")


def _sequences() -> Iterator[tuple[str, Iterator[Situation]]]:
    """Situations one after another, and what is special about them."""
    for n in samples.COUNTS:
        objects = [samples.states(n, frame) for frame in range(_FRAMES)]
        for limits in _LIMITS:
            moving = (_situation(objects[k], 8.0, frame=k, limits=limits) for k in range(_FRAMES))
            yield f"with {n} objects and {limits.braking:g} m/s^2 of braking", moving
    few = samples.states(5)
    for speed in (0.0, 1e-6, 40.0, MAX_TRACK_VALUE):
        yield f"at {speed:g} m/s", iter([_situation(few, speed)])
    for stop_m in (-3.0, 0.0, 0.3, 30.0):
        yield f"with a line at {stop_m:g} m", iter([_situation(few, speed, stop_m=stop_m) for speed in (0.0, 9.0)])
    for name, points in _routes().items():
        yield f"on {name}", iter([_situation(few, speed, points=points) for speed in (0.0, 9.0)])
    for turn in (np.pi / 2.0, np.pi):
        yield f"turned by {turn:.2f} rad", iter([_situation(few, 5.0, turn=turn)])
    for name, objects_there in _absurd().items():
        yield f"with {name}", iter([_situation(objects_there, speed) for speed in (0.0, 9.0)])


def _situation(
    objects: ObjectStates,
    speed: float,
    *,
    frame: int = 0,
    points: Floats | None = None,
    stop_m: float = np.inf,
    turn: float = 0.0,
    limits: CarLimits = _LIMITS[0],
) -> Situation:
    """A car beside the first point of its lane, which it drives along at a speed, turned by an angle."""
    points = _routes()["a straight lane"] + 0.8 * frame if points is None else points
    heading = float(np.arctan2(*(points[1] - points[0])[::-1])) + turn
    return Situation(
        frame * samples.PERIOD_NS,
        np.array([points[0, 0], points[0, 1] + 0.3, 0.8]),
        speed * np.array([np.cos(heading), np.sin(heading), 0.0]),
        heading,
        _SIZE,
        RouteAhead(points, np.linspace(14.0, 4.0, len(points)), stop_m),
        objects,
        limits,
    )


def _routes() -> dict[str, Floats]:
    angle, far = np.arange(81.0) / 8.0, np.arange(81.0)
    return {
        "a straight lane": np.column_stack([far, np.zeros(81)]),
        "a lane that turns around itself": 8.0 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]),
        "two points": np.array([[0.0, 0.0], [1.0, 0.5]]),
        "two points in one place": np.zeros((2, 2)),
        "a lane far away": np.column_stack([far + 1e7, far - 1e7]),
    }


def _absurd() -> dict[str, ObjectStates]:
    """Objects that no sensor reports, but that are valid messages."""
    objects = samples.states(6)
    n, far = len(objects), np.array([1.0, -1.0, 1.0])
    return {
        "objects without size": objects.with_(size=np.zeros((n, 3))),
        "objects of negative size": objects.with_(size=-objects.size),
        "objects as large as the world": objects.with_(size=np.full((n, 3), MAX_TRACK_VALUE)),
        "objects at the end of the world": objects.with_(position=np.tile(MAX_TRACK_VALUE * far, (n, 1))),
        "objects faster than light": objects.with_(velocity=np.tile(MAX_TRACK_VALUE * far, (n, 1))),
        "objects in the place of the car": objects.with_(position=np.tile([0.0, 0.3, 0.8], (n, 1))),
        "objects in one place ahead": objects.with_(
            position=np.tile([9.0, 0.0, 0.8], (n, 1)), velocity=np.zeros((n, 3)), yaw=np.zeros(n)
        ),
        "objects of one id": objects.with_(id=np.zeros(n, np.int64)),
        "objects of headings beyond a turn": objects.with_(yaw=np.full(n, 1e8)),
    }
