"""Which lies count as detected."""

from typing import Any

import numpy as np

from mast_zenoh.study.defences.matrix_trial import detected_lies


def lies(*rows: tuple[int, str, str, int, bool]) -> dict[str, Any]:
    """Columns of lies from rows of frame, agent, effect, id, observable."""
    frame, agent, effect, id_, observable = zip(*rows, strict=True)
    return {
        "frame": np.array(frame),
        "agent": np.array(agent, object),
        "effect": np.array(effect, object),
        "id": np.array(id_),
        "observable": np.array(observable),
    }


NEVER = [False] * 3


def test_a_lie_is_all_that_one_agent_tells_about_one_object() -> None:
    claims = lies((1, "a", "inserted", 7, True), (2, "a", "inserted", 7, True), (2, "b", "inserted", 7, False))
    assert detected_lies(claims, np.array(NEVER), np.array(NEVER)) == {"all": 2, "observable": 1, "detected": 0}


def test_withholding_the_object_detects_the_lie() -> None:
    claims = lies((1, "a", "inserted", 7, True), (2, "a", "inserted", 7, True), (2, "a", "inserted", 8, True))
    counts = detected_lies(claims, np.array([False, True, False]), np.array(NEVER))
    assert counts == {"all": 2, "observable": 2, "detected": 1}


def test_an_object_withheld_for_a_moment_is_no_detected_lie() -> None:
    claims = lies(*((frame, "a", "inserted", 7, True) for frame in range(3)))
    assert detected_lies(claims, np.array([False, True, False]), np.array(NEVER))["detected"] == 0
    assert detected_lies(claims, np.array([False, True, True]), np.array(NEVER))["detected"] == 1


def test_a_detection_before_the_lie_was_observable_is_chance() -> None:
    claims = lies((1, "a", "inserted", 7, False), (2, "a", "inserted", 7, True), (3, "a", "inserted", 7, False))
    assert detected_lies(claims, np.array([True, False, False]), np.array(NEVER))["detected"] == 0
    assert detected_lies(claims, np.array([False, False, True]), np.array(NEVER))["detected"] == 1


def test_a_removed_object_is_detected_by_suspension_alone() -> None:
    claims = lies((1, "a", "removed", 7, True), (2, "a", "removed", 7, True), (3, "a", "removed", 7, True))
    assert detected_lies(claims, np.array([True] * 3), np.array(NEVER))["detected"] == 0
    assert detected_lies(claims, np.array(NEVER), np.array([False, True, False]))["detected"] == 1


def test_a_run_without_lies_has_none() -> None:
    none = {name: column[:0] for name, column in lies((1, "a", "inserted", 7, True)).items()}
    empty = np.zeros(0, bool)
    assert detected_lies(none, empty, empty) == {"all": 0, "observable": 0, "detected": 0}
