"""Needless and missed braking, and whether attacks caused it."""

from __future__ import annotations

import numpy as np
import pytest
from measured import Row, effects, labelled, passage
from metric_oracles import cars

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import Driving, Record, Series
from mast_zenoh.metrics import driving as driving_metrics
from mast_zenoh.metrics.driving import Drive
from mast_zenoh.metrics.record import Snapshot

FRAMES = 40
#: The ego drives east at 10 m/s; its safe distance from a stationary car is 5 + 0.25 + 11^2 / 8 = 20.4 m, both cars are
#: 4.5 m long: it has to brake for a car that stands at 50 m from frame 26 on.
FIRST = 26
CAR = (50.0, 0.0)


def ego(frame: int) -> tuple[float, float]:
    return float(frame), 0.0


def driven(
    truth: list[tuple[float, float]], local: list[list[tuple[float, float]]], lies: list[Row] | None = None
) -> dict[tuple[str, str], Drive]:
    """Consequences for the ego, given stationary objects and tracks by frame."""
    record = Record(["ego"])
    for frame, tracked in enumerate(local):
        objects = cars(ego(frame), *truth, velocity=np.array([[10.0, 0.0, 0.0], *[[0.0] * 3] * len(truth)]))
        record.add_truth(frame, objects, np.full((len(objects), 1), 50), np.array([[*ego(frame), 0.0]]), np.array([0]))
        believed = cars(ego(frame), *tracked, id=[100, *(200 + k for k in range(len(tracked)))])
        record.add(frame, [Series("ego", "local")], Snapshot.of(believed))
    measured_effects = effects(*(lies or []), passages=[passage("eve", "detections", "ego")] if lies else ())
    scores, _, labels, _ = labelled(record, measured_effects)
    return driving_metrics.drives(Driving(), record, scores, labels, record.truth(scores.frames))


def frames(mask: np.ndarray) -> list[int]:
    return np.flatnonzero(mask).tolist()


def test_a_correct_estimate_brakes_when_the_truth_does() -> None:
    driving = driven([CAR], [[CAR]] * FRAMES)
    for estimate in ("truth", "local"):
        drive = driving["ego", estimate]
        assert frames(drive.brake) == list(range(FIRST, FRAMES))
        assert drive.gap_m == pytest.approx([CAR[0] - frame - 4.5 for frame in range(FRAMES)])
        assert drive.ttc_s == pytest.approx(drive.gap_m / 10.0)
        assert not drive.needless.any()
        assert not drive.omitted.any()
    assert driving["ego", "truth"].objects.tolist() == [1] * FRAMES, "the ego does not block itself"


@pytest.mark.parametrize("attacked", [True, False])
def test_missed_braking_is_due_to_an_attack_that_hid_the_object(attacked: bool) -> None:
    hidden: list[Row] = [("eve", frame, "removed", 0, CAR, (0.0, 0.0)) for frame in range(FRAMES)]
    drive = driven([CAR], [[]] * FRAMES, hidden if attacked else [])["ego", "local"]
    assert frames(drive.omitted) == list(range(FIRST, FRAMES))
    assert frames(drive.attacked) == (list(range(FIRST, FRAMES)) if attacked else [])
    assert drive.missed.tolist() == [1] * FRAMES
    assert not drive.brake.any()
    assert np.isinf(drive.gap_m).all()


@pytest.mark.parametrize("attacked", [True, False])
def test_needless_braking_is_due_to_an_attack_that_inserted_the_object(attacked: bool) -> None:
    lies: list[Row] = [("eve", frame, "inserted", 7, CAR, (0.0, 0.0)) for frame in range(FRAMES)]
    drive = driven([], [[CAR]] * FRAMES, lies if attacked else [])["ego", "local"]
    assert frames(drive.needless) == list(range(FIRST, FRAMES))
    assert frames(drive.attacked) == (list(range(FIRST, FRAMES)) if attacked else [])
    assert drive.false.tolist() == [1] * FRAMES
    assert not drive.omitted.any()


def test_needless_braking_is_not_blamed_on_an_attack_elsewhere_in_the_corridor() -> None:
    """The inserted object is too far ahead to brake for; the near one is clutter."""
    far = (90.0, 0.0)
    lies: list[Row] = [("eve", frame, "inserted", 7, far, (0.0, 0.0)) for frame in range(FRAMES)]
    drive = driven([], [[CAR, far]] * FRAMES, lies)["ego", "local"]
    assert frames(drive.needless) == list(range(FIRST, FRAMES))
    assert not drive.attacked.any()
    assert drive.false[FIRST] == 2


@pytest.mark.parametrize(("ahead_m", "obstacle"), [(2.5, False), (4.4, False), (4.6, True)])
def test_a_duplicate_of_the_ego_that_overlaps_it_is_counted_but_no_obstacle(ahead_m: float, obstacle: bool) -> None:
    """The ego is 4.5 m long, and so is the duplicate ahead of it."""
    ghosts = [[(frame + ahead_m, 0.0)] for frame in range(FRAMES)]
    drive = driven([], ghosts)["ego", "local"]
    assert drive.brake.all() == drive.needless.all() == obstacle
    assert drive.needless.any() == obstacle
    assert drive.objects.tolist() == [int(obstacle)] * FRAMES
    assert drive.overlapping.tolist() == [1 if obstacle else 2] * FRAMES, "its own track is one of them"


def test_a_past_collision_cannot_be_braked_for_even_by_the_truth() -> None:
    driving = driven([CAR], [[CAR]] * 60)
    for estimate in ("truth", "local"):
        assert frames(driving["ego", estimate].brake) == list(range(FIRST, 46))
    assert frames(driving["ego", "truth"].overlapping > 0) == list(range(46, 55))


def test_an_agent_that_is_not_an_object_of_the_scene_is_no_vehicle() -> None:
    record = Record(["pole"])
    record.add_truth(0, cars(CAR), np.full((1, 1), 50), np.zeros((1, 3)), np.array([-1]))
    record.add(0, [Series("pole", "local")], Snapshot.of(ObjectStates.empty()))
    scores, _, labels, _ = labelled(record, effects())
    assert driving_metrics.drives(Driving(), record, scores, labels, record.truth(scores.frames)) == {}


def test_the_summary_covers_the_scored_frames() -> None:
    driving = driving_metrics.summary(driven([CAR], [[]] * FRAMES), slice(20, 30))["ego"]
    assert driving["truth"]["brake_share"] == pytest.approx((30 - FIRST) / 10)
    assert driving["local"]["missed_brake_share"] == pytest.approx((30 - FIRST) / 10)
    assert driving["local"]["corridor_missed"] == 1.0
    assert driving["local"]["min_ttc_s"] is None
    assert driving["truth"]["min_ttc_s"] == pytest.approx((CAR[0] - 29 - 4.5) / 10.0)
