"""Needless and missed braking, and whether attacks caused it."""

import numpy as np
import pytest
from metric_worlds import LOCAL, NOTHING, Row, cars, effects, labelled, passage, recorded

from mast_zenoh.metrics import Driving, Series
from mast_zenoh.metrics import driving as driving_metrics
from mast_zenoh.metrics.driving import Drive

FRAMES = 40
#: The ego drives east at 10 m/s; its safe distance from a stationary car is 5 + 0.25 + 11^2 / 8 = 20.4 m, both cars are
#: 4.5 m long: it has to brake for a car that stands at 50 m from frame 26 on.
FIRST = 26
CAR, FAR = (50.0, 0.0), (90.0, 0.0)
BRAKING, NEVER = list(range(FIRST, FRAMES)), []


def ego(frame: int) -> tuple[float, float]:
    return float(frame), 0.0


def driven(
    truth: list[tuple[float, float]], local: list[list[tuple[float, float]]], lies: list[Row] | None = None
) -> dict[tuple[str, str], Drive]:
    """Consequences for the ego, given stationary objects and tracks by frame."""
    frames = range(len(local))
    velocity = np.array([[10.0, 0.0, 0.0], *[[0.0] * 3] * len(truth)])
    record = recorded(
        [cars(ego(frame), *truth, velocity=velocity) for frame in frames],
        {LOCAL: [cars(ego(frame), *tracked, id=[100, *range(200, 200 + len(tracked))]) for frame, tracked in
                 enumerate(local)]},
        places=[(*ego(frame), 0.0) for frame in frames],
        own=0,
    )  # fmt: skip
    measured_effects = effects(*(lies or []), passages=[passage("eve", "detections", "ego")] if lies else ())
    scores, _, labels, _ = labelled(record, measured_effects)
    return driving_metrics.drives(Driving(), record, scores, labels)


def shown(effect: str, at: tuple[float, float]) -> list[Row]:
    return [("eve", frame, effect, 7, at, (0.0, 0.0)) for frame in range(FRAMES)]


def frames(mask: np.ndarray) -> list[int]:
    return np.flatnonzero(mask).tolist()


def test_a_correct_estimate_brakes_when_the_truth_does() -> None:
    driving = driven([CAR], [[CAR]] * FRAMES)
    for estimate in ("truth", "local"):
        drive = driving["ego", estimate]
        assert frames(drive.brake) == BRAKING
        assert drive.gap_m == pytest.approx([CAR[0] - frame - 4.5 for frame in range(FRAMES)])
        assert drive.ttc_s == pytest.approx(drive.gap_m / 10.0)
        assert not (drive.needless | drive.omitted | drive.attacked).any()
        assert not (drive.false + drive.missed).any()
    assert driving["ego", "truth"].objects.tolist() == [1] * FRAMES, "the ego does not block itself"


@pytest.mark.parametrize(
    ("truth", "tracked", "lies", "omitted", "needless", "attacked", "errors"),
    [
        ([CAR], [], shown("removed", CAR), BRAKING, NEVER, BRAKING, (0, 1)),
        ([CAR], [], [], BRAKING, NEVER, NEVER, (0, 1)),
        ([CAR, FAR], [], shown("removed", FAR), BRAKING, NEVER, NEVER, (0, 2)),
        ([], [CAR], shown("inserted", CAR), NEVER, BRAKING, BRAKING, (1, 0)),
        ([], [CAR], [], NEVER, BRAKING, NEVER, (1, 0)),
        ([], [CAR, FAR], shown("inserted", FAR), NEVER, BRAKING, NEVER, (2, 0)),
    ],
    ids=[
        "missed braking is due to an attack that hid the object",
        "without an attack it is not",
        "nor is it due to one that hid an object too far ahead to brake for",
        "needless braking is due to an attack that inserted the object",
        "without an attack it is not either",
        "nor is it due to one that inserted an object too far ahead to brake for",
    ],
)
def test_wrong_braking_is_due_to_an_attack_on_the_object(truth, tracked, lies, omitted, needless, attacked, errors):
    drive = driven(truth, [tracked] * FRAMES, lies)["ego", "local"]
    assert (frames(drive.omitted), frames(drive.needless)) == (omitted, needless)
    assert frames(drive.attacked) == attacked
    assert (drive.false[FIRST], drive.missed[FIRST]) == errors
    assert drive.brake.any() == bool(needless)
    assert np.isinf(drive.gap_m).all() == (not tracked)


@pytest.mark.parametrize(("ahead_m", "obstacle"), [(2.5, False), (4.4, False), (4.6, True)])
def test_a_duplicate_of_the_ego_that_overlaps_it_is_counted_but_no_obstacle(ahead_m: float, obstacle: bool) -> None:
    """The ego is 4.5 m long, and so is the duplicate ahead of it."""
    drive = driven([], [[(frame + ahead_m, 0.0)] for frame in range(FRAMES)])["ego", "local"]
    assert drive.brake.all() == drive.brake.any() == drive.needless.all() == drive.needless.any() == obstacle
    assert drive.objects.tolist() == [int(obstacle)] * FRAMES
    assert drive.overlapping.tolist() == [1 if obstacle else 2] * FRAMES, "its own track is one of them"


def test_a_past_collision_cannot_be_braked_for_even_by_the_truth() -> None:
    driving = driven([CAR], [[CAR]] * 60)
    for estimate in ("truth", "local"):
        assert frames(driving["ego", estimate].brake) == list(range(FIRST, 46))
    assert frames(driving["ego", "truth"].overlapping > 0) == list(range(46, 55))


def test_an_agent_that_is_not_an_object_of_the_scene_is_no_vehicle() -> None:
    record = recorded([cars(CAR)], {Series("pole", "local"): [NOTHING]}, agents=["pole"])
    scores, _, labels, _ = labelled(record, effects())
    assert driving_metrics.drives(Driving(), record, scores, labels) == {}


def test_the_summary_covers_the_scored_frames() -> None:
    """A false object that was there before a lie, which is known from frame 28 on, is not the lie's."""
    missing = driving_metrics.summary(driven([CAR], [[]] * FRAMES), slice(20, 30))["ego"]
    assert missing["truth"] == {
        "corridor_objects": 1.0,
        "overlapping_objects": 0.0,
        "min_ttc_s": pytest.approx((CAR[0] - 29 - 4.5) / 10.0),
        "brake_share": pytest.approx((30 - FIRST) / 10),
    }
    assert missing["local"] == dict.fromkeys(missing["local"], 0.0) | {
        "overlapping_objects": 1.0,
        "min_ttc_s": None,
        "corridor_missed": 1.0,
        "missed_brake_share": pytest.approx((30 - FIRST) / 10),
    }
    for first, by_attack in ((0, 0.4), (28, 0.0)):
        lies = [row for row in shown("inserted", CAR) if row[1] >= first]
        inserted = driving_metrics.summary(driven([], [[CAR]] * FRAMES, lies), slice(20, 30))["ego"]["local"]
        shares = (inserted[name] for name in ("brake_share", "needless_brake_share", "needless_brake_share_attack"))
        assert [*shares, inserted["corridor_false"]] == pytest.approx([0.4, 0.4, by_attack, 1.0])
    assert inserted["missed_brake_share_attack"] == 0.0


def test_the_table_has_a_row_for_each_estimate_and_frame() -> None:
    driving = driven([CAR], [[]] * FRAMES)
    table = driving_metrics.table(driving, np.arange(FRAMES))
    assert list(zip(table["estimate"].tolist(), table["frame"].tolist(), strict=True)) == [
        (estimate, frame) for estimate in ("truth", "local") for frame in range(FRAMES)
    ]
    assert set(table["agent"]) == {"ego"}
    for name in Drive._fields:
        expected = np.concatenate([getattr(drive, name) for drive in driving.values()])
        assert table[name][:FRAMES].tolist() == expected[:FRAMES].tolist()
    assert np.isnan(table["gap_m"][FRAMES:]).all(), "without an object there is no gap"
