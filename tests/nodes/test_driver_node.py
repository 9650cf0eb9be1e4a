"""The driver's node: one command a frame, from the newest estimate of an earlier one."""

from functools import cache

import numpy as np
import pytest
from driven import driven
from tiny_world import Bench, pose, tracks

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.integrity.views import view_columns
from mast_zenoh.tracking.view import SensorView

COMMAND = "agent/ego/command"


@cache
def resolved(estimate: str = "mission", veto: bool = False) -> Resolved:
    return driven(
        f"estimate={estimate}", frames=4, edit=lambda content: content["drivers"]["ego"].update({"veto": veto})
    )


def view(free_m: float) -> dict[str, np.ndarray]:
    """Columns of a view all around whose rays end at a distance."""
    sensor = SensorView(np.array([0.0, 0.0, 2.0]), np.eye(3), -np.pi, np.pi, -0.5, 0.3, 100.0)
    return view_columns(sensor, np.full((8, 120), free_m))


def route(stop: float | None = None, points: int = 81) -> dict[str, np.ndarray]:
    return {
        "position": np.column_stack([np.arange(float(points)), np.zeros(points)]),
        "speed": np.full(points, 14.0),
        "stop": np.array([] if stop is None else [stop]),
        "size": np.array([4.5, 1.9]),
    }


def moving(speed: float = 10.0) -> dict[str, np.ndarray]:
    return pose() | {"velocity": np.array([speed, 0.0, 0.0])}


def drive(bench: Bench, frame: int, estimate: dict | None, port: str = "mission") -> float | None:
    """The acceleration that the driver commands in a frame; None: it commands nothing."""
    published = bench.play(frame, pose=moving(), route=route())
    if estimate is not None:
        published += bench.send(port, estimate, frame)
    assert {key for key, _ in published} <= {COMMAND}
    assert {message.header.frame for _, message in published} <= {frame}
    return float(published[0][1].body["acceleration"][0]) if published else None


@pytest.mark.parametrize("estimate", ["safety", "mission"])
def test_it_brakes_for_a_car_ahead_in_the_frame_after_it_learns_of_it(estimate: str) -> None:
    bench = Bench(resolved(estimate), "driver_ego")
    assert drive(bench, 0, tracks(), estimate) == -3.0, "it has not seen anything yet"
    free = drive(bench, 1, tracks((30.0, 0.0)), estimate)
    assert free is not None
    assert free > 0.0
    braking = drive(bench, 2, tracks((30.0, 0.0)), estimate)
    assert braking is not None
    assert braking < -1.0


def test_objects_move_on_until_they_are_used() -> None:
    """A car that leaves at the same speed is as far ahead a frame later."""
    standing, leaving = (Bench(resolved(), "driver_ego") for _ in range(2))
    found = []
    for bench, velocity in ((standing, (0.0, 0.0)), (leaving, (10.0, 0.0))):
        drive(bench, 0, tracks((30.0, 0.0), velocity=velocity))
        found.append(drive(bench, 1, None))
    assert found[0] is not None
    assert found[1] is not None
    assert found[0] < found[1] < 0.7


def test_without_an_estimate_for_too_long_it_brakes_and_counts_that() -> None:
    bench = Bench(resolved(), "driver_ego", estimate_age_s=0.2)
    commands = [drive(bench, frame, tracks() if frame == 0 else None) for frame in range(6)]
    assert [command == -3.0 for command in commands] == [True, False, False, True, True, True]
    assert bench.node.finish(bench.host) == {"commands": 6, "blind": 4, "absurd": 0}


def test_it_stops_at_a_line() -> None:
    bench = Bench(resolved(), "driver_ego")
    drive(bench, 0, tracks())
    bench.clock(1)
    bench.send("pose", moving(), 1)
    ((_, message),) = bench.send("route", route(stop=15.0), 1)
    assert message.body["acceleration"][0] < -2.0


@pytest.mark.parametrize(
    ("body", "kind"),
    [
        (route(points=1), "points"),
        (route(points=1001), "points"),
        (route() | {"speed": np.full(81, 1e300)}, "route.speed"),
        (route() | {"stop": np.array([np.nan])}, "route.stop"),
    ],
    ids=["short", "long", "fast", "nan"],
)
def test_a_route_that_leads_nowhere_is_rejected_and_the_frame_has_no_command(body: dict, kind: str) -> None:
    bench = Bench(resolved(), "driver_ego")
    bench.clock(0)
    bench.send("pose", moving(), 0)
    assert bench.send("route", body, 0) == []
    assert [reason for _, reason in bench.host.rejected] == [kind]
    assert drive(bench, 1, tracks()) is not None


def with_veto(mission: dict, own: dict, seen: dict | None, *order: str, later: int = 1) -> float:
    """The acceleration that a driver with a veto commands some frames after it got two estimates and a view."""
    bench = Bench(resolved(veto=True), "driver_ego")
    bench.play(0, pose=moving(), route=route())
    bodies = {"mission": mission, "safety": own} | ({} if seen is None else {"view": seen})
    for port in order or bodies:
        bench.send(port, bodies[port], 0)
    for frame in range(1, later + 1):
        published = bench.play(frame, pose=moving(), route=route())
    return float(published[0][1].body["acceleration"][0])


def test_with_a_veto_it_brakes_for_own_tracks_that_the_mission_estimate_lacks() -> None:
    assert with_veto(tracks(), tracks((30.0, 0.0)), view(100.0)) < -1.0


@pytest.mark.parametrize(
    ("seen", "brakes"), [(view(100.0), False), (view(20.0), True), (view(30.0), True), (None, True)]
)
def test_with_a_veto_it_ignores_what_stands_where_its_own_sensor_sees_free_space(seen, brakes) -> None:
    assert (with_veto(tracks((30.0, 0.0)), tracks(), seen) < -1.0) is brakes


def test_with_a_veto_it_brakes_without_own_tracks_for_too_long_and_an_old_view_refutes_nothing() -> None:
    bench = Bench(resolved(veto=True), "driver_ego")
    bench.play(0, pose=moving(), route=route(), mission=tracks(), view=view(100.0))
    assert drive(bench, 1, tracks()) == -3.0
    assert with_veto(tracks((30.0, 0.0)), tracks(), view(100.0), later=6) == -3.0, "all of it is too old"


def test_a_view_that_covers_nothing_is_rejected() -> None:
    bench = Bench(resolved(veto=True), "driver_ego")
    bench.clock(0)
    assert bench.send("view", view(-1.0), 0) == []
    assert [reason for _, reason in bench.host.rejected] == ["view"]


@pytest.mark.parametrize("estimate", ["truth", "safety"])
def test_a_veto_needs_the_mission_estimate(estimate: str) -> None:
    with pytest.raises(ConfigurationError, match=r"veto.*True.*estimate"):
        resolved(estimate, True)


def test_a_driver_that_returns_something_else_than_a_command_is_named(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench(resolved("mission"), "driver_ego")
    drive(bench, 0, tracks(), "mission")
    bench.node.driver.drive = lambda situation: (1.0, 0.0)
    assert drive(bench, 1, tracks(), "mission") is None
    assert "FollowingDriver.drive returned tuple" in caplog.text
