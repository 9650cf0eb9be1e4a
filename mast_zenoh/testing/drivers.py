"""Checks of drivers: limits, determinism, the order of objects, absurd situations, and no shared state."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator

import numpy as np

from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.driving import CarLimits, Command, Driver, RouteAhead, Situation
from mast_zenoh.gather import MAX_TRACK_VALUE
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, unchanged

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
