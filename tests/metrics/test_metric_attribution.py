"""Each false and each missed object of the picture has a cause, and lies have an author."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from metric_oracles import cars

from mast_zenoh.metrics import Attribution, Record, Scorer, cause_counts, time_to_first_false
from mast_zenoh.states import ObjectStates

PERIOD_S = 0.1
NOTHING = ObjectStates.empty()
_COLUMNS = [f"{when}_{axis}" for when in ("before", "after") for axis in "xyz"] + ["vx", "vy", "vz"]


def attacks(*rows: tuple[str, int, str, int, tuple[float, float], tuple[float, float]]) -> dict[str, np.ndarray]:
    """Reports: adversary, frame, action, target, where (before it was hidden, or after it was added), velocity."""
    table = {name: np.array([row[k] for row in rows]) for k, name in enumerate(("adversary", "frame", "action"))}
    table = {name: column if rows else column.astype(object) for name, column in table.items()}
    table |= {name: np.zeros(len(rows)) for name in _COLUMNS}
    table["frame"] = table["frame"].astype(np.int64)
    table["target"] = np.array([row[3] for row in rows], np.int64)
    for k, (_, _, action, _, where, velocity) in enumerate(rows):
        for axis, x, v in zip("xy", where, velocity, strict=True):
            table[f"{'before' if action == 'removed' else 'after'}_{axis}"][k] = x
            table[f"v{axis}"][k] = v
            if action == "moved":
                table[f"before_{axis}"][k] = v
    return table


def seen(truth, picture, lies=(), local=None, points=None):
    """The table of objects with its causes, of a run in which the ego alone is there.

    truth, picture: what there is and what is believed, a set of cars for each frame; local: the ego's own tracks
    """
    record = Record(["ego"])
    for frame, (objects, believed) in enumerate(zip(truth, picture, strict=True)):
        many = np.full((len(objects), 1), 50) if points is None else np.array(points[frame]).reshape(-1, 1)
        record.add_truth(frame, objects, many, np.zeros((1, 3)), np.array([-1]))
        record.add_picture(frame, believed)
        record.add_tracks(frame, "ego", "local", (picture if local is None else local)[frame])
    table = Scorer().score(record).objects
    boxes = record.truth(record.frames()).boxes
    cause, by = Attribution().label(table, attacks(*lies), boxes, PERIOD_S)
    return table | {"cause": cause, "by": by}


def causes(table) -> list[tuple[int, str, str, str]]:
    """Frame, kind, cause and author of every row that has a cause."""
    names = ("frame", "kind", "cause", "by")
    return [tuple(row) for row in zip(*(table[name].tolist() for name in names), strict=True) if row[2]]


CAR = cars((0.0, 0.0), id=[1])


def test_only_what_is_wrong_with_the_picture_has_a_cause() -> None:
    table = seen([CAR], [cars((0.1, 0.0), (40.0, 0.0), id=[5, 6])])
    assert causes(table) == [(0, "track", "clutter", "")]
    assert set(table["cause"][table["estimator"] == "local"]) == {""}


def test_a_track_of_an_injected_object_is_its_adversarys() -> None:
    lies = [("eve", 0, "added", 0, (40.0, 0.0), (0.0, 0.0)), ("mallory", 0, "added", 0, (-40.0, 0.0), (0.0, 0.0))]
    table = seen([CAR], [cars((0.0, 0.0), (39.0, 0.0), (-40.0, 1.0), (0.0, 60.0), id=[5, 6, 7, 8])], lies)
    assert Counter(causes(table)) == Counter(
        [
            (0, "track", "injected", "eve"),
            (0, "track", "injected", "mallory"),
            (0, "track", "clutter", ""),
        ]
    )


def test_a_lie_that_two_tell_is_both_of_theirs() -> None:
    lies = [(name, 0, "added", 0, (40.0, 0.0), (0.0, 0.0)) for name in ("mallory", "eve")]
    table = seen([CAR], [cars((0.0, 0.0), (40.0, 0.0), id=[5, 6])], lies)
    assert causes(table) == [(0, "track", "injected", "eve+mallory")]


def test_a_false_track_stays_its_adversarys_while_it_coasts_on_after_the_lie_has_ended() -> None:
    """The lie ends at 69 m; the track goes on, and bends away from where the lie would have gone."""
    lies = [("eve", frame, "added", 3, (60.0 + frame, 0.0), (10.0, 0.0)) for frame in range(10)]
    picture = [cars((0.0, 0.0), (60.0 + frame, 0.5 * max(frame - 9, 0)), id=[5, 6]) for frame in range(30)]
    table = seen([CAR] * 30, picture, lies)
    assert causes(table) == [(frame, "track", "injected", "eve") for frame in range(30)]


def test_it_is_nobodys_when_it_lasts_far_longer_than_a_track_can_coast() -> None:
    lies = [("eve", 0, "added", 3, (40.0, 0.0), (0.0, 0.0))]
    picture = [cars((0.0, 0.0), (40.0, 0.0), id=[5, 6])] * 100
    assert causes(seen([CAR] * 100, picture, lies))[-1] == (99, "track", "clutter", "")


def test_who_met_a_real_object_is_no_lie_any_more() -> None:
    lies = [("eve", 0, "added", 3, (40.0, 0.0), (0.0, 0.0))]
    truth = [CAR, cars((0.0, 0.0), (55.0, 0.0), id=[1, 2]), CAR]
    picture = [cars((0.0, 0.0), (x, 0.0), id=[5, 6]) for x in (40.0, 55.0, 70.0)]
    assert causes(seen(truth, picture, lies)) == [(0, "track", "injected", "eve"), (2, "track", "lag", "")]


def test_a_hidden_object_that_is_missed_is_missed_because_of_that() -> None:
    lies = [("eve", frame, "removed", 0, (0.5, 0.0), (0.0, 0.0)) for frame in (14, 15)]
    picture = [CAR if frame < 14 else NOTHING for frame in range(17)]
    assert causes(seen([CAR] * 17, picture, lies)) == [(f, "truth", "removed", "eve") for f in (14, 15, 16)]


def test_a_displaced_object_makes_a_false_and_a_missed_one() -> None:
    lies = [("eve", 0, "moved", 0, (30.0, 0.0), (0.0, 0.0))]
    table = seen([CAR], [cars((30.0, 0.5), id=[5])], lies)
    assert causes(table) == [(0, "truth", "moved", "eve"), (0, "track", "moved", "eve")]


def test_an_object_whose_track_is_lured_away_is_the_liars() -> None:
    lies = [("eve", frame, "added", 0, (2.0 * (frame - 11), 0.0), (20.0, 0.0)) for frame in range(12, 16)]
    picture = [cars((0.0 if frame < 12 else 2.0 * (frame - 10), 0.0), id=[5]) for frame in range(16)]
    found = [row for row in causes(seen([CAR] * 16, picture, lies)) if row[1] == "truth"]
    assert found == [(frame, "truth", "injected", "eve") for frame in range(12, 16)]


def test_what_is_said_of_one_agent_does_not_depend_on_another_in_whose_range_nothing_is_believed() -> None:
    lies = [("eve", frame, "added", 0, (2.0 * (frame - 11), 0.0), (20.0, 0.0)) for frame in range(12, 16)]
    truth = cars((0.0, 0.0), (-500.0, 0.0), id=[1, 9])
    record = Record(["apart", "ego"])
    for frame in range(16):
        record.add_truth(frame, truth, np.full((2, 2), 50), np.array([[-500.0, 0, 0], [0, 0, 0]]), np.array([-1, -1]))
        record.add_picture(frame, cars((0.0 if frame < 12 else 2.0 * (frame - 10), 0.0), id=[5]))
    table = Scorer().score(record).objects
    boxes = record.truth(record.frames()).boxes
    cause, by = Attribution().label(table, attacks(*lies), boxes, PERIOD_S)
    mine = (table["agent"] == "ego") & (table["kind"] == "truth") & (cause != "")
    assert set(zip(cause[mine].tolist(), by[mine].tolist(), strict=True)) == {("injected", "eve")}


def test_a_second_track_of_an_object_is_a_duplicate() -> None:
    assert causes(seen([CAR], [cars((0.0, 0.0), (2.5, 0.0), id=[5, 6])])) == [(0, "track", "duplicate", "")]


def test_an_object_that_has_just_come_has_no_track_yet_and_one_that_has_gone_has_one_still() -> None:
    truth = [NOTHING] * 3 + [CAR] * 5 + [NOTHING] * 2
    picture = [NOTHING] * 5 + [CAR] * 5
    assert causes(seen(truth, picture)) == [
        (3, "truth", "lag", ""),
        (4, "truth", "lag", ""),
        (8, "track", "lag", ""),
        (9, "track", "lag", ""),
    ]


def test_a_track_too_far_from_its_object_lags_and_so_the_object_is_missed() -> None:
    found = causes(seen([CAR] * 12, [*[CAR] * 11, cars((4.0, 0.0), id=[1])]))
    assert found == [(11, "truth", "lag", ""), (11, "track", "lag", "")]


def test_a_track_of_an_object_that_nobody_sees_is_there_for_occlusion_or_range() -> None:
    table = seen([CAR, CAR], [CAR, CAR], points=[[50], [0]])
    assert causes(table) == [(1, "track", "occlusion or range", "")]


@pytest.mark.parametrize(("local", "cause"), [(NOTHING, "occlusion or range"), (CAR, "fusion")])
def test_what_no_agent_tracks_is_out_of_sight_and_what_one_does_was_lost_in_fusion(local, cause: str) -> None:
    found = causes(seen([CAR] * 12, [*[CAR] * 11, NOTHING], local=[*[CAR] * 11, local]))
    assert found == [(11, "truth", cause, "")]


def test_the_order_of_the_reports_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    truth = [cars(*rng.uniform(-50, 50, (6, 2))) for _ in range(8)]
    picture = [cars(*rng.uniform(-50, 50, (9, 2))) for _ in range(8)]
    lies = [
        (str(rng.choice(["eve", "mallory"])), int(rng.integers(8)), str(rng.choice(["added", "removed"])), k,
         tuple(rng.uniform(-50, 50, 2)), (1.0, 0.0))
        for k in range(40)
    ]  # fmt: skip
    assert causes(seen(truth, picture, lies)) == causes(seen(truth, picture, lies[::-1]))


def test_causes_are_counted_and_the_first_false_track_is_timed() -> None:
    lies = [("eve", frame, "added", 0, (40.0, 0.0), (0.0, 0.0)) for frame in range(2, 9)]
    lies += [("mallory", 4, "added", 0, (-40.0, 0.0), (0.0, 0.0))]
    picture = [
        cars((0.0, 0.0), *([(40.0, 0.0)] if frame >= 5 else []), id=[1, 2][: 1 + (frame >= 5)]) for frame in range(9)
    ]
    table = seen([CAR] * 9, picture, lies)
    assert cause_counts(table, ["ego"], np.arange(8)) == {"ego": {"fp": {"injected": 3}, "fn": {}}}
    assert time_to_first_false(table, attacks(*lies), PERIOD_S) == {"eve": pytest.approx(0.3), "mallory": None}


def test_an_empty_run_has_no_causes() -> None:
    assert causes(seen([], [])) == []
    assert causes(seen([NOTHING], [NOTHING])) == []
