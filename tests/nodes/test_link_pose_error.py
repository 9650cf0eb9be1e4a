"""An error of a sender's pose or clock moves its tracks and its view alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tiny_world import Bench, pose, tiny, tracks

from mast_zenoh.arrays.geometry import rotation_from_quaternion, rotation_from_yaw
from mast_zenoh.integrity.views import view_columns
from mast_zenoh.messages.schemas import Message
from mast_zenoh.tracking.view import SensorView


def bench(*up: dict[str, Any]) -> Bench:
    """The ego's link by itself, in a run whose agents send views."""

    def edit(content: dict[str, Any]) -> None:
        content["links"] = {"ego": dict(up=list(up))}
        content["keyexpr"] = dict(map="testbed.toml", rewrites=["views.toml"])

    link = Bench(tiny("baseline", edit=edit, infrastructure=1), "link_ego")
    link.play(0, pose=pose(40.0, -30.0))
    link.clock(1)
    return link


def view(x: float, y: float, yaw: float = 0.0) -> dict[str, np.ndarray]:
    """The view of a sensor."""
    sensor = SensorView(np.array([x, y, 1.8]), rotation_from_yaw(yaw), -1.0, 1.0, -0.3, 0.1, 100.0)
    return view_columns(sensor, np.full((2, 3), 50.0))


def sent(link: Bench, frame: int) -> tuple[Message, Message]:
    """The tracks and the view of a frame, after the link."""
    (_, moved_tracks), (_, moved_view) = (
        *link.send("tracks", tracks((50.0, -30.0)), frame),
        *link.send("view", view(41.0, -30.0, 0.3), frame),
    )
    return moved_tracks, moved_view


def place(message: Message, point: tuple[float, float, float]) -> np.ndarray:
    """A point of a tracks message in the world."""
    turn = rotation_from_quaternion(message.body["rotation"])
    return np.asarray(turn @ np.array(point) + message.body["origin"])


def test_a_constant_error_moves_tracks_and_view_as_one_rigid_body() -> None:
    link = bench(dict(type="PoseError", bias_m=[2.0, -1.0], bias_yaw_rad=0.1))
    moved_tracks, moved_view = sent(link, 1)
    assert moved_view.body["position"] == pytest.approx(place(moved_tracks, (41.0, -30.0, 1.8)))
    before, after = (rotation_from_quaternion(body["rotation"]) for body in (view(0, 0, 0.3), moved_view.body))
    assert after == pytest.approx(rotation_from_yaw(0.1) @ before)
    assert np.array_equal(moved_view.body["free"], view(0, 0)["free"])


def test_a_wrong_heading_turns_tracks_about_the_sender() -> None:
    """Not about the origin of the world: an object at the sender stays, one 10 m ahead moves by 1 m."""
    link = bench(dict(type="PoseError", bias_yaw_rad=0.1))
    moved, _ = sent(link, 1)
    assert place(moved, (40.0, -30.0, 0.0)) == pytest.approx([40.0, -30.0, 0.0])
    assert place(moved, (50.0, -30.0, 0.0)) == pytest.approx([40 + 10 * np.cos(0.1), -30 + 10 * np.sin(0.1), 0.0])


def test_tracks_and_view_of_a_frame_have_the_same_random_error() -> None:
    link = bench(dict(type="Delay", mean_s=0.0), dict(type="PoseError", position_std_m=1.0, yaw_std_rad=0.05))
    places = []
    for frame in range(1, 4):
        moved_tracks, moved_view = sent(link, frame)
        assert moved_view.body["position"] == pytest.approx(place(moved_tracks, (41.0, -30.0, 1.8)))
        places.append(moved_view.body["position"])
        link.send("pose", pose(40.0, -30.0), frame)
        link.clock(frame + 1)
    assert np.ptp(np.array(places), axis=0)[:2].min() > 0.01, "another error for each frame"


def test_reports_tell_that_the_view_was_altered() -> None:
    link = bench(dict(type="PoseError", bias_m=[2.0, 0.0]))
    sent(link, 1)
    ((_, report),) = link.clock(2)
    assert report.body["port"].tolist() == [0, 5]
    assert set(report.body["fate"].tolist()) == {4}
