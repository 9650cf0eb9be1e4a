"""Each false and each missed object has a cause, and each lie an author."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from measured import Row, effects, explained, labelled, passage
from metric_oracles import cars

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import Record, Series, causes_of
from mast_zenoh.metrics.record import Snapshot

NOTHING = ObjectStates.empty()


def recorded(truth, picture, local=None, points=None) -> Record:
    """A run of the ego alone.

    truth, picture: a set of cars for each frame; local: the ego's own tracks
    """
    record = Record(["ego"])
    for frame, (objects, believed) in enumerate(zip(truth, picture, strict=True)):
        many = np.full((len(objects), 1), 50) if points is None else np.array(points[frame]).reshape(-1, 1)
        record.add_truth(frame, objects, many, np.zeros((1, 3)), np.array([-1]))
        record.add(frame, [Series("", "picture")], Snapshot.of(believed))
        record.add(frame, [Series("ego", "local")], Snapshot.of((picture if local is None else local)[frame]))
    return record


def seen(truth, picture, lies: tuple[Row, ...] | list[Row] = (), local=None, points=None):
    """The table of objects with its causes."""
    return explained(recorded(truth, picture, local, points), effects(*lies))


def causes(table, estimator: str = "picture") -> list[tuple[int, str, str, str]]:
    """Frame, kind, cause and author of every row of an estimate with a cause."""
    selected = {name: column[table["estimator"] == estimator] for name, column in table.items()}
    names = ("frame", "kind", "cause", "by")
    return [tuple(row) for row in zip(*(selected[name].tolist() for name in names), strict=True) if row[2]]


CAR = cars((0.0, 0.0), id=[1])


def test_every_error_of_an_estimate_and_nothing_else_has_a_cause() -> None:
    table = seen([CAR], [cars((0.1, 0.0), (40.0, 0.0), id=[5, 6])], local=[cars((0.1, 0.0), id=[5])])
    assert causes(table) == [(0, "track", "clutter", "")]
    assert causes(table, "local") == []
    table = seen([CAR] * 12, [CAR] * 12, local=[CAR] * 11 + [cars((0.0, 40.0), id=[6])])
    assert causes(table) == []
    assert causes(table, "local") == [(11, "truth", "tracking", ""), (11, "track", "clutter", "")]


def test_a_track_of_an_inserted_object_is_attributed_to_its_adversary() -> None:
    lies = [("eve", 0, "inserted", 0, (40.0, 0.0), (0.0, 0.0)), ("mallory", 0, "inserted", 0, (-40.0, 0.0), (0.0, 0.0))]
    table = seen([CAR], [cars((0.0, 0.0), (39.0, 0.0), (-40.0, 1.0), (0.0, 60.0), id=[5, 6, 7, 8])], lies)
    assert Counter(causes(table)) == Counter(
        [
            (0, "track", "inserted", "eve"),
            (0, "track", "inserted", "mallory"),
            (0, "track", "clutter", ""),
        ]
    )


def test_an_object_inserted_by_two_adversaries_is_attributed_to_both() -> None:
    lies = [(name, 0, "inserted", 0, (40.0, 0.0), (0.0, 0.0)) for name in ("mallory", "eve")]
    table = seen([CAR], [cars((0.0, 0.0), (40.0, 0.0), id=[5, 6])], lies)
    assert causes(table) == [(0, "track", "inserted", "eve+mallory")]


def test_a_coasting_false_track_is_still_attributed_to_its_adversary() -> None:
    """The false object ends at 69 m; its track goes on and bends away."""
    lies = [("eve", frame, "inserted", 3, (60.0 + frame, 0.0), (10.0, 0.0)) for frame in range(10)]
    picture = [cars((0.0, 0.0), (60.0 + frame, 0.5 * max(frame - 9, 0)), id=[5, 6]) for frame in range(30)]
    table = seen([CAR] * 30, picture, lies)
    assert causes(table) == [(frame, "track", "inserted", "eve") for frame in range(30)]


def test_a_false_track_before_the_first_insertion_is_natural() -> None:
    """A clutter track is at 40 m; from frame 5 an object is inserted there."""
    lies = [("eve", frame, "inserted", 3, (40.0, 0.0), (0.0, 0.0)) for frame in range(5, 10)]
    picture = [cars((0.0, 0.0), (40.0, 0.0), id=[5, 6])] * 10
    rows = causes(seen([CAR] * 10, picture, lies))
    assert rows == [
        *((frame, "track", "clutter", "") for frame in range(5)),
        *((frame, "track", "inserted", "eve") for frame in range(5, 10)),
    ]


def test_a_false_track_that_lasts_too_long_is_not_attributed() -> None:
    lies = [("eve", 0, "inserted", 3, (40.0, 0.0), (0.0, 0.0))]
    picture = [cars((0.0, 0.0), (40.0, 0.0), id=[5, 6])] * 100
    assert causes(seen([CAR] * 100, picture, lies))[-1] == (99, "track", "clutter", "")


def test_a_false_track_that_has_matched_a_real_object_is_not_attributed() -> None:
    lies = [("eve", 0, "inserted", 3, (40.0, 0.0), (0.0, 0.0))]
    truth = [CAR, cars((0.0, 0.0), (55.0, 0.0), id=[1, 2]), CAR]
    picture = [cars((0.0, 0.0), (x, 0.0), id=[5, 6]) for x in (40.0, 55.0, 70.0)]
    assert causes(seen(truth, picture, lies)) == [(0, "track", "inserted", "eve"), (2, "track", "lag", "")]


def test_a_missed_hidden_object_is_attributed_to_the_attack() -> None:
    lies = [("eve", frame, "removed", 0, (0.5, 0.0), (0.0, 0.0)) for frame in (14, 15)]
    picture = [CAR if frame < 14 else NOTHING for frame in range(17)]
    assert causes(seen([CAR] * 17, picture, lies)) == [(f, "truth", "removed", "eve") for f in (14, 15, 16)]


def test_a_displaced_object_causes_a_false_track_and_a_missed_object() -> None:
    lies = [("eve", 0, "moved", 0, (30.0, 0.0), (0.0, 0.0))]
    table = seen([CAR], [cars((30.0, 0.5), id=[5])], lies)
    assert causes(table) == [(0, "truth", "moved", "eve"), (0, "track", "moved", "eve")]


def test_an_object_with_a_displaced_track_is_attributed_to_the_adversary() -> None:
    lies = [("eve", frame, "inserted", 0, (2.0 * (frame - 11), 0.0), (20.0, 0.0)) for frame in range(12, 16)]
    picture = [cars((0.0 if frame < 12 else 2.0 * (frame - 10), 0.0), id=[5]) for frame in range(16)]
    rows = [row for row in causes(seen([CAR] * 16, picture, lies)) if row[1] == "truth"]
    assert rows == [(frame, "truth", "inserted", "eve") for frame in range(12, 16)]


def test_the_causes_of_one_agent_do_not_depend_on_another_without_estimates() -> None:
    lies = [("eve", frame, "inserted", 0, (2.0 * (frame - 11), 0.0), (20.0, 0.0)) for frame in range(12, 16)]
    truth = cars((0.0, 0.0), (-500.0, 0.0), id=[1, 9])
    record = Record(["apart", "ego"])
    for frame in range(16):
        record.add_truth(frame, truth, np.full((2, 2), 50), np.array([[-500.0, 0, 0], [0, 0, 0]]), np.array([-1, -1]))
        believed = cars((0.0 if frame < 12 else 2.0 * (frame - 10), 0.0), id=[5])
        record.add(frame, [Series("", "picture")], Snapshot.of(believed))
    table = explained(record, effects(*lies))
    selected = (table["agent"] == "ego") & (table["kind"] == "truth") & (table["cause"] != "")
    assert set(zip(table["cause"][selected].tolist(), table["by"][selected].tolist(), strict=True)) == {
        ("inserted", "eve")
    }


def test_a_second_track_of_an_object_is_a_duplicate() -> None:
    assert causes(seen([CAR], [cars((0.0, 0.0), (2.5, 0.0), id=[5, 6])])) == [(0, "track", "duplicate", "")]


def test_new_objects_have_no_track_yet_and_departed_ones_still_have_one() -> None:
    truth = [NOTHING] * 3 + [CAR] * 5 + [NOTHING] * 2
    picture = [NOTHING] * 5 + [CAR] * 5
    assert causes(seen(truth, picture)) == [
        (3, "truth", "lag", ""),
        (4, "truth", "lag", ""),
        (8, "track", "lag", ""),
        (9, "track", "lag", ""),
    ]


def test_a_track_too_far_from_its_object_lags_and_the_object_is_missed() -> None:
    rows = causes(seen([CAR] * 12, [*[CAR] * 11, cars((4.0, 0.0), id=[1])]))
    assert rows == [(11, "truth", "lag", ""), (11, "track", "lag", "")]


def test_a_track_of_an_unseen_object_is_due_to_occlusion_or_range() -> None:
    table = seen([CAR, CAR], [CAR, CAR], points=[[50], [0]])
    assert causes(table) == [(1, "track", "occlusion or range", "")]


@pytest.mark.parametrize(("local", "cause"), [(NOTHING, "occlusion or range"), (CAR, "fusion")])
def test_an_object_tracked_by_no_agent_is_out_of_sight_otherwise_it_was_lost_in_fusion(local, cause: str) -> None:
    rows = causes(seen([CAR] * 12, [*[CAR] * 11, NOTHING], local=[*[CAR] * 11, local]))
    assert rows == [(11, "truth", cause, "")]


def test_the_order_of_the_effects_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    truth = [cars(*rng.uniform(-50, 50, (6, 2))) for _ in range(8)]
    picture = [cars(*rng.uniform(-50, 50, (9, 2))) for _ in range(8)]
    lies = [
        (str(rng.choice(["eve", "mallory"])), int(rng.integers(8)), str(rng.choice(["inserted", "removed"])), k,
         tuple(rng.uniform(-50, 50, 2)), (1.0, 0.0))
        for k in range(40)
    ]  # fmt: skip
    assert causes(seen(truth, picture, lies)) == causes(seen(truth, picture, lies[::-1]))


def test_causes_are_counted_by_estimate_in_the_scored_frames() -> None:
    lies = [("eve", frame, "inserted", 0, (40.0, 0.0), (0.0, 0.0)) for frame in range(2, 9)]
    picture = [
        cars((0.0, 0.0), *([(40.0, 0.0)] if frame >= 5 else []), id=[1, 2][: 1 + (frame >= 5)]) for frame in range(9)
    ]
    scores, _, labels, _ = labelled(recorded([CAR] * 9, picture, local=[CAR] * 9), effects(*lies))
    counted = causes_of(scores, labels.cause, labels.switch_cause, np.arange(8))
    by_series = dict(zip(scores.series, counted, strict=True))
    assert by_series["ego", "picture"]["causes"] == {"fp": {"inserted": 3}, "fn": {}, "id_switches": {}}
    assert by_series["ego", "picture"]["fp_split"] == {"fault": 0.0, "attack": 3 / 8, "natural": 0.0}
    assert by_series["ego", "local"]["causes"] == {"fp": {}, "fn": {}, "id_switches": {}}


def test_an_attack_on_one_agents_detections_does_not_affect_another_agents_own_tracks() -> None:
    record = Record(["ego", "infra_1"])
    wrong = cars((40.0, 0.0), id=[7])
    for frame in range(3):
        record.add_truth(frame, NOTHING, np.zeros((0, 2)), np.zeros((2, 3)), np.array([-1, -1]))
        for series in (Series("", "picture"), Series("ego", "local"), Series("infra_1", "local")):
            record.add(frame, [series], Snapshot.of(wrong))
    lies = [("eve", frame, "inserted", -1, (40.0, 0.0), (0.0, 0.0)) for frame in range(3)]
    measured_effects = effects(*lies, passages=[passage("eve", "detections", "infra_1")], of=[0, 0, 0])
    table = explained(record, measured_effects)

    def cause(agent: str, estimator: str) -> set[str]:
        return set(table["cause"][(table["agent"] == agent) & (table["estimator"] == estimator)])

    assert cause("infra_1", "local") == cause("ego", "picture") == {"inserted"}
    assert cause("ego", "local") == {"clutter"}


def test_objects_inserted_by_a_link_are_faults_without_an_author() -> None:
    lies = [("link_1", 0, "moved", 0, (30.0, 0.0), (0.0, 0.0))]
    moved = effects(*lies, passages=[passage("link_1", "detections", "ego")], of=[0])
    table = explained(recorded([CAR], [cars((30.0, 0.5), id=[5])]), moved, {"link_1": "link"})
    assert causes(table) == [(0, "truth", "link or fault", ""), (0, "track", "link or fault", "")]


@pytest.mark.parametrize(("hit", "cause"), [(True, "removed"), (False, "tracking")])
def test_an_identity_switch_after_hiding_is_attributed_to_the_adversary(hit: bool, cause: str) -> None:
    lies = [("eve", frame, "removed", 0, (0.0 if hit else 50.0, 0.0), (0.0, 0.0)) for frame in range(4, 8)]
    picture = [cars((0.0, 0.0), id=[5 if frame < 6 else 6]) for frame in range(12)]
    scores, _, labels, _ = labelled(recorded([CAR] * 12, picture, local=[CAR] * 12), effects(*lies))
    assert scores.series[int(scores.switches.series[0])] == ("ego", "picture")
    assert [(int(f), int(i)) for f, i in zip(scores.switches.frame, scores.switches.truth_id, strict=True)] == [(6, 1)]
    assert causes_of(scores, labels.cause, labels.switch_cause, np.arange(12))[0]["causes"]["id_switches"] == {cause: 1}
    assert labels.switch_by.tolist() == ["eve" if hit else ""]


def test_an_empty_run_has_no_causes() -> None:
    assert causes(seen([], [])) == []
    assert causes(seen([NOTHING], [NOTHING])) == []
