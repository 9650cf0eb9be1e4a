"""Faults of sensors change an agent's detections, and nothing else."""

from typing import Any

import numpy as np
import pytest
from tiny_world import Run, tiny

from mast_zenoh.arrays.states import Detections
from mast_zenoh.sensing import sensor_pose, to_world

BLIND = dict(type="BlindSector", at=0.3, until=0.8, azimuth_min_deg=-180.0, azimuth_max_deg=180.0)
GHOST = dict(type="GhostDetections", at=0.3, until=0.8, places=[(20.0, 15.0, 0.75)], probability=1.0)
SOURCE, KEY = "agent/ego/detections/@tap/0", "agent/ego/detections"


def played(*faults: dict[str, Any], links: dict[str, Any] | None = None) -> Run:
    """A run of the tiny world in which agents send views."""

    def edit(content: dict[str, Any]) -> None:
        content["faults"] = list(faults)
        content["links"] = links or {}
        content["keyexpr"] = dict(map="testbed.toml", rewrites=["views.toml"])

    run = Run(tiny("baseline", edit=edit, infrastructure=1))
    assert not run.failures
    return run


def counts(run: Run, key: str) -> list[int]:
    """Numbers of detections by frame."""
    return [len(message.body["position"]) for message in run.decoded(key, "detections")]


def test_detections_can_be_lost_on_their_way_to_the_agent() -> None:
    run = played(dict(type="Partition", at=0.3, until=0.8, on=KEY))
    assert [message.header.frame for message in run.decoded(SOURCE, "detections")] == list(range(12))
    assert [message.header.frame for message in run.decoded(KEY, "detections")] == [0, 1, 2, 8, 9, 10, 11]


def test_a_blind_sensor_detects_nothing_from_the_beginning_to_the_end_of_its_fault() -> None:
    run = played(BLIND | dict(node="ego"))
    before, after = counts(run, SOURCE), counts(run, KEY)
    assert min(before) > 0
    assert [n for n, known in zip(after, before, strict=True) if n != known] == [0] * 5
    assert np.flatnonzero(np.array(after) == 0).tolist() == [3, 4, 5, 6, 7]


def test_the_claimed_view_is_unchanged() -> None:
    faulty, sound = played(BLIND | dict(node="ego")), played(dict(type="Loss", at=0.3, probability=0.0, node="ego"))
    key = "agent/ego/view"
    assert faulty.messages[key] == sound.messages[key]
    assert faulty.messages["agent/infra_1/tracks"] == sound.messages["agent/infra_1/tracks"]


def test_a_ghost_is_detected_where_it_is_in_the_world() -> None:
    run = played(GHOST | dict(node="ego"))
    before, after = counts(run, SOURCE), counts(run, KEY)
    assert np.subtract(after, before).tolist() == [0, 0, 0, 1, 1, 1, 1, 1, 0, 0, 0, 0]
    for message, pose in zip(
        run.decoded(KEY, "detections")[3:8], run.decoded("agent/ego/pose", "pose")[3:8], strict=True
    ):
        sensor = sensor_pose(pose.body["position"], np.eye(3), message.body["mount_position"], np.eye(3))
        ghost = to_world(Detections.from_columns(message.body), *sensor).position[-1]
        assert ghost == pytest.approx([20.0, 15.0, 0.75], abs=1.5)


def test_rules_for_messages_leave_detections_alone() -> None:
    """The same link is on the detections and on the tracks of the ego, but a partition stops only its tracks."""
    run = played(GHOST | dict(node="ego"), dict(type="Partition", at=0.3, until=0.8, node="ego"))
    assert len(counts(run, KEY)) == len(counts(run, SOURCE)) == 12
    assert len(run.decoded("agent/ego/tracks", "tracks")) == 12
    received = [key for key in run.messages if key.startswith("agent/ego/tracks/@tap/broker")]
    assert [len(run.messages[key]) for key in received] == [7]
