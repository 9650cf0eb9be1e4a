"""Each false or missed object has a cause; one due to an attack, an adversary."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from measured import Row, effects, explained, labelled, passage
from metric_oracles import cars

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import Record, Series, causes_of
from mast_zenoh.metrics.attributor import Withheld
from mast_zenoh.metrics.record import Snapshot
from mast_zenoh.metrics.trust import TrustUpdate

NOTHING = ObjectStates.empty()


def recorded(truth, picture, local=None, points=None) -> Record:
    """A run of the ego alone.

    truth, picture: a set of cars for each frame; local: the ego's own tracks, by default those of the picture that
    are within 1 m of a true object
    """
    record = Record(["ego"])
    for frame, (objects, tracks) in enumerate(zip(truth, picture, strict=True)):
        n_points = np.full((len(objects), 1), 50) if points is None else np.array(points[frame]).reshape(-1, 1)
        record.add_truth(frame, objects, n_points, np.zeros((1, 3)), np.array([-1]))
        record.add(frame, [Series("", "picture")], Snapshot.of(tracks))
        record.add(
            frame, [Series("ego", "local")], Snapshot.of(good(objects, tracks) if local is None else local[frame])
        )
    return record


def good(objects: ObjectStates, tracks: ObjectStates) -> ObjectStates:
    """The tracks within 1 m of a true object."""
    apart = np.linalg.norm(tracks.position[:, None] - objects.position, axis=2)
    return tracks.select((apart <= 1.0).any(axis=1))


def cause_table(truth, picture, manipulations: tuple[Row, ...] | list[Row] = (), local=None, points=None):
    """The table of objects, with the causes of their errors."""
    return explained(recorded(truth, picture, local, points), effects(*manipulations))


def causes(table, estimator: str = "picture") -> list[tuple[int, str, str, str]]:
    """Frame, kind, cause and adversary of the rows of an estimate that have a cause."""
    selected = {name: column[table["estimator"] == estimator] for name, column in table.items()}
    names = ("frame", "kind", "cause", "by")
    return [tuple(row) for row in zip(*(selected[name].tolist() for name in names), strict=True) if row[2]]


CAR = cars((0.0, 0.0), id=[1])


def test_errors_and_only_errors_have_a_cause() -> None:
    table = cause_table([CAR], [cars((0.1, 0.0), (40.0, 0.0), id=[5, 6])], local=[cars((0.1, 0.0), id=[5])])
    assert causes(table) == [(0, "track", "clutter", "")]
    assert causes(table, "local") == []
    table = cause_table([CAR] * 12, [CAR] * 12, local=[CAR] * 11 + [cars((0.0, 40.0), id=[6])])
    assert causes(table) == []
    assert causes(table, "local") == [(11, "truth", "tracking", ""), (11, "track", "clutter", "")]


def test_a_track_of_an_inserted_object_is_attributed_to_its_adversary() -> None:
    manipulations = [
        ("eve", 0, "inserted", 0, (40.0, 0.0), (0.0, 0.0)),
        ("mallory", 0, "inserted", 0, (-40.0, 0.0), (0.0, 0.0)),
    ]
    table = cause_table(
        [CAR], [cars((0.0, 0.0), (39.0, 0.0), (-40.0, 1.0), (0.0, 60.0), id=[5, 6, 7, 8])], manipulations
    )
    assert Counter(causes(table)) == Counter(
        [
            (0, "track", "inserted", "eve"),
            (0, "track", "inserted", "mallory"),
            (0, "track", "clutter", ""),
        ]
    )


def test_an_object_inserted_by_two_adversaries_is_attributed_to_both() -> None:
    manipulations = [(name, 0, "inserted", 0, (40.0, 0.0), (0.0, 0.0)) for name in ("mallory", "eve")]
    table = cause_table([CAR], [cars((0.0, 0.0), (40.0, 0.0), id=[5, 6])], manipulations)
    assert causes(table) == [(0, "track", "inserted", "eve+mallory")]


def test_a_coasting_false_track_is_still_attributed_to_its_adversary() -> None:
    """The false object ends at 69 m; its track continues and curves away."""
    manipulations = [("eve", frame, "inserted", 3, (60.0 + frame, 0.0), (10.0, 0.0)) for frame in range(10)]
    picture = [cars((0.0, 0.0), (60.0 + frame, 0.5 * max(frame - 9, 0)), id=[5, 6]) for frame in range(30)]
    table = cause_table([CAR] * 30, picture, manipulations)
    assert causes(table) == [(frame, "track", "inserted", "eve") for frame in range(30)]


def test_a_false_track_before_the_first_insertion_is_natural() -> None:
    """A clutter track is at 40 m; from frame 5 an object is inserted there."""
    manipulations = [("eve", frame, "inserted", 3, (40.0, 0.0), (0.0, 0.0)) for frame in range(5, 10)]
    picture = [cars((0.0, 0.0), (40.0, 0.0), id=[5, 6])] * 10
    rows = causes(cause_table([CAR] * 10, picture, manipulations))
    assert rows == [
        *((frame, "track", "clutter", "") for frame in range(5)),
        *((frame, "track", "inserted", "eve") for frame in range(5, 10)),
    ]


def test_a_false_track_that_lasts_too_long_is_not_attributed() -> None:
    manipulations = [("eve", 0, "inserted", 3, (40.0, 0.0), (0.0, 0.0))]
    picture = [cars((0.0, 0.0), (40.0, 0.0), id=[5, 6])] * 100
    assert causes(cause_table([CAR] * 100, picture, manipulations))[-1] == (99, "track", "clutter", "")


def test_a_false_track_that_has_matched_a_real_object_is_not_attributed() -> None:
    manipulations = [("eve", 0, "inserted", 3, (40.0, 0.0), (0.0, 0.0))]
    truth = [CAR, cars((0.0, 0.0), (55.0, 0.0), id=[1, 2]), CAR]
    picture = [cars((0.0, 0.0), (x, 0.0), id=[5, 6]) for x in (40.0, 55.0, 70.0)]
    assert causes(cause_table(truth, picture, manipulations)) == [
        (0, "track", "inserted", "eve"),
        (2, "track", "lag", ""),
    ]


def test_a_missed_hidden_object_is_attributed_to_the_attack() -> None:
    manipulations = [("eve", frame, "removed", 0, (0.5, 0.0), (0.0, 0.0)) for frame in (14, 15)]
    picture = [CAR if frame < 14 else NOTHING for frame in range(17)]
    assert causes(cause_table([CAR] * 17, picture, manipulations)) == [
        (f, "truth", "removed", "eve") for f in (14, 15, 16)
    ]


def test_a_displaced_object_causes_a_false_track_and_a_missed_object() -> None:
    manipulations = [("eve", 0, "moved", 0, (30.0, 0.0), (0.0, 0.0))]
    table = cause_table([CAR], [cars((30.0, 0.5), id=[5])], manipulations)
    assert causes(table) == [(0, "truth", "moved", "eve"), (0, "track", "moved", "eve")]


def test_an_object_with_a_displaced_track_is_attributed_to_the_adversary() -> None:
    manipulations = [("eve", frame, "inserted", 0, (2.0 * (frame - 11), 0.0), (20.0, 0.0)) for frame in range(12, 16)]
    picture = [cars((0.0 if frame < 12 else 2.0 * (frame - 10), 0.0), id=[5]) for frame in range(16)]
    rows = [row for row in causes(cause_table([CAR] * 16, picture, manipulations)) if row[1] == "truth"]
    assert rows == [(frame, "truth", "inserted", "eve") for frame in range(12, 16)]


def test_the_causes_of_one_agent_do_not_depend_on_another_without_estimates() -> None:
    manipulations = [("eve", frame, "inserted", 0, (2.0 * (frame - 11), 0.0), (20.0, 0.0)) for frame in range(12, 16)]
    truth = cars((0.0, 0.0), (-500.0, 0.0), id=[1, 9])
    record = Record(["apart", "ego"])
    for frame in range(16):
        record.add_truth(frame, truth, np.full((2, 2), 50), np.array([[-500.0, 0, 0], [0, 0, 0]]), np.array([-1, -1]))
        tracks = cars((0.0 if frame < 12 else 2.0 * (frame - 10), 0.0), id=[5])
        record.add(frame, [Series("", "picture")], Snapshot.of(tracks))
    table = explained(record, effects(*manipulations))
    selected = (table["agent"] == "ego") & (table["kind"] == "truth") & (table["cause"] != "")
    assert set(zip(table["cause"][selected].tolist(), table["by"][selected].tolist(), strict=True)) == {
        ("inserted", "eve")
    }


def test_a_second_track_of_an_object_is_a_duplicate() -> None:
    assert causes(cause_table([CAR], [cars((0.0, 0.0), (2.5, 0.0), id=[5, 6])])) == [(0, "track", "duplicate", "")]


def test_new_objects_have_no_track_yet_and_departed_ones_still_have_one() -> None:
    truth = [NOTHING] * 3 + [CAR] * 5 + [NOTHING] * 2
    picture = [NOTHING] * 5 + [CAR] * 5
    assert causes(cause_table(truth, picture)) == [
        (3, "truth", "lag", ""),
        (4, "truth", "lag", ""),
        (8, "track", "lag", ""),
        (9, "track", "lag", ""),
    ]


def test_a_track_too_far_from_its_object_lags_and_the_object_is_missed() -> None:
    rows = causes(cause_table([CAR] * 12, [*[CAR] * 11, cars((4.0, 0.0), id=[1])]))
    assert rows == [(11, "truth", "lag", ""), (11, "track", "lag", "")]


def test_a_track_of_an_unseen_object_is_due_to_occlusion_or_range() -> None:
    table = cause_table([CAR, CAR], [CAR, CAR], points=[[50], [0]])
    assert causes(table) == [(1, "track", "occlusion or range", "")]


@pytest.mark.parametrize(("local", "cause"), [(NOTHING, "occlusion or range"), (CAR, "fusion")])
def test_a_miss_is_due_to_occlusion_if_no_agent_tracks_the_object_otherwise_to_fusion(local, cause: str) -> None:
    rows = causes(cause_table([CAR] * 12, [*[CAR] * 11, NOTHING], local=[*[CAR] * 11, local]))
    assert rows == [(11, "truth", cause, "")]


def test_the_order_of_the_effects_does_not_matter() -> None:
    rng = np.random.default_rng(0)
    truth = [cars(*rng.uniform(-50, 50, (6, 2))) for _ in range(8)]
    picture = [cars(*rng.uniform(-50, 50, (9, 2))) for _ in range(8)]
    manipulations = [
        (str(rng.choice(["eve", "mallory"])), int(rng.integers(8)), str(rng.choice(["inserted", "removed"])), k,
         tuple(rng.uniform(-50, 50, 2)), (1.0, 0.0))
        for k in range(40)
    ]  # fmt: skip
    assert causes(cause_table(truth, picture, manipulations)) == causes(
        cause_table(truth, picture, manipulations[::-1])
    )


def test_causes_are_counted_by_estimate_in_the_scored_frames() -> None:
    manipulations = [("eve", frame, "inserted", 0, (40.0, 0.0), (0.0, 0.0)) for frame in range(2, 9)]
    picture = [
        cars((0.0, 0.0), *([(40.0, 0.0)] if frame >= 5 else []), id=[1, 2][: 1 + (frame >= 5)]) for frame in range(9)
    ]
    scores, _, labels, _ = labelled(recorded([CAR] * 9, picture, local=[CAR] * 9), effects(*manipulations))
    counted = causes_of(scores, labels.cause, labels.switch_cause, np.arange(8))
    by_series = dict(zip(scores.series, counted, strict=True))
    assert by_series["ego", "picture"]["causes"] == {"fp": {"inserted": 3}, "fn": {}, "id_switches": {}}
    assert by_series["ego", "picture"]["fp_split"] == {"fault": 0.0, "attack": 3 / 8, "withheld": 0.0, "natural": 0.0}
    assert by_series["ego", "local"]["causes"] == {"fp": {}, "fn": {}, "id_switches": {}}


def test_an_attack_on_one_agents_detections_does_not_affect_another_agents_own_tracks() -> None:
    record = Record(["ego", "infra_1"])
    wrong = cars((40.0, 0.0), id=[7])
    for frame in range(3):
        record.add_truth(frame, NOTHING, np.zeros((0, 2)), np.zeros((2, 3)), np.array([-1, -1]))
        for series in (Series("", "picture"), Series("ego", "local"), Series("infra_1", "local")):
            record.add(frame, [series], Snapshot.of(wrong))
    manipulations = [("eve", frame, "inserted", -1, (40.0, 0.0), (0.0, 0.0)) for frame in range(3)]
    measured_effects = effects(*manipulations, passages=[passage("eve", "detections", "infra_1")], of=[0, 0, 0])
    table = explained(record, measured_effects)

    def cause(agent: str, estimator: str) -> set[str]:
        return set(table["cause"][(table["agent"] == agent) & (table["estimator"] == estimator)])

    assert cause("infra_1", "local") == {"inserted"}
    assert cause("ego", "picture") == {"clutter"}  # the ego reports it too, without the attack
    assert cause("ego", "local") == {"clutter"}


def test_objects_moved_by_a_link_are_faults_without_an_adversary() -> None:
    manipulations = [("link_1", 0, "moved", 0, (30.0, 0.0), (0.0, 0.0))]
    moved = effects(*manipulations, passages=[passage("link_1", "detections", "ego")], of=[0])
    table = explained(recorded([CAR], [cars((30.0, 0.5), id=[5])]), moved, {"link_1": "link"})
    assert causes(table) == [(0, "truth", "link or fault", ""), (0, "track", "link or fault", "")]


@pytest.mark.parametrize(("same_object", "cause"), [(True, "removed"), (False, "tracking")])
def test_an_identity_switch_after_hiding_is_attributed_to_the_adversary(same_object: bool, cause: str) -> None:
    manipulations = [
        ("eve", frame, "removed", 0, (0.0 if same_object else 50.0, 0.0), (0.0, 0.0)) for frame in range(4, 8)
    ]
    picture = [cars((0.0, 0.0), id=[5 if frame < 6 else 6]) for frame in range(12)]
    scores, _, labels, _ = labelled(recorded([CAR] * 12, picture, local=[CAR] * 12), effects(*manipulations))
    assert scores.series[int(scores.switches.series[0])] == ("ego", "picture")
    assert [(int(f), int(i)) for f, i in zip(scores.switches.frame, scores.switches.truth_id, strict=True)] == [(6, 1)]
    assert causes_of(scores, labels.cause, labels.switch_cause, np.arange(12))[0]["causes"]["id_switches"] == {cause: 1}
    assert labels.switch_by.tolist() == ["eve" if same_object else ""]


def test_an_empty_run_has_no_causes() -> None:
    assert causes(cause_table([], [])) == []
    assert causes(cause_table([NOTHING], [NOTHING])) == []


def trust(frame: int, withheld: tuple[tuple[float, float], ...] = (), suspended: bool = False) -> TrustUpdate:
    """A message about trust in infra_1 and infra_2, of whom the second may be suspended."""
    n = len(withheld)
    return TrustUpdate(
        frame,
        {
            "agents": ["infra_1", "infra_2"],
            "state": np.array([1, 3 if suspended else 1], np.uint8),
            "log_odds": np.zeros(2),
            "reason": ["", ""],
            "position": np.array([(*place, 0.0) for place in withheld]).reshape(n, 3),
            "withheld": np.ones(n, np.uint8),
        },
    )


def defended(frames: int, reporting: tuple[str, ...], updates: list[TrustUpdate]) -> list[tuple[int, str, str, str]]:
    """Causes of errors where agents report a car that is not in the picture."""
    agents = ("infra_1", "infra_2")
    record = Record(agents)
    for frame in range(frames):
        record.add_truth(frame, CAR, np.full((1, 2), 50), np.zeros((2, 3)), np.array([-1, -1]))
        record.add(frame, [Series("", "picture")], Snapshot.of(NOTHING))
        for agent in agents:
            record.add(frame, [Series(agent, "local")], Snapshot.of(CAR if agent in reporting else NOTHING))
    eve = [("eve", frame, "removed", 0, (0.5, 0.0), (0.0, 0.0)) for frame in range(frames)]
    withheld = Withheld.of(updates, agents, np.arange(frames), 3)
    return causes(explained(record, effects(*eve), withheld=withheld))[: frames - 10]


def test_a_missed_object_that_the_command_centre_withheld_is_not_attributed_to_the_attack() -> None:
    updates = [trust(frame, ((0.4, 0.0), (30.0, 0.0))) for frame in range(12)]
    rows = defended(12, ("infra_1", "infra_2"), updates)
    assert rows == [(frame, "truth", "withheld", "infra_1+infra_2") for frame in range(2)]


def test_a_missed_object_that_only_a_suspended_agent_reports_is_withheld() -> None:
    updates = [trust(frame, suspended=True) for frame in range(12)]
    assert defended(12, ("infra_2",), updates) == [(frame, "truth", "withheld", "infra_2") for frame in range(2)]
    assert {cause for _, _, cause, _ in defended(12, ("infra_1", "infra_2"), updates)} != {"withheld"}
    assert {cause for _, _, cause, _ in defended(12, (), updates)} == {"removed"}
