"""Scores of runs: small ones by hand, random ones against plain loops."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from metric_worlds import NOTHING, PICTURE, best_pairs, cars, recorded

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.metrics import CenterDistanceAssigner, IoU3DGreedyAssigner, Record, Scorer, Series, SetDistance
from mast_zenoh.metrics.measures import MEASURES, ScoredRun, measured, per_frame
from mast_zenoh.metrics.record import Snapshot
from mast_zenoh.metrics.scores import Scores


def record(truth: list[ObjectStates], picture: list[ObjectStates], **more) -> Record:
    """A run of one agent, the ego."""
    return recorded(truth, {PICTURE: picture}, **more)


def summary_of(scores: Scores, scored: slice = slice(None)) -> dict:
    """Our metrics by agent, estimator and name."""
    return measured([*MEASURES.values()], ScoredRun(scores, scored))[0]


def summary(truth: list[ObjectStates], picture: list[ObjectStates], scored: slice = slice(None)) -> dict:
    numbers = summary_of(Scorer().score(record(truth, picture)), scored)["ego"]["picture"]
    return json.loads(json.dumps(numbers, allow_nan=False))


def counts(scores, agent="ego", estimator="picture"):
    table = per_frame(scores)
    selected = (table["agent"] == agent) & (table["estimator"] == estimator)
    return [tuple(int(table[name][k]) for name in ("fn", "fp", "tp")) for k in np.flatnonzero(selected)]


def outcomes(scores) -> set[tuple[str, str, int, int]]:
    t = scores.objects()
    return set(zip(t["kind"].tolist(), t["outcome"].tolist(), t["id"].tolist(), t["match_id"].tolist(), strict=True))


def test_scores_of_a_small_frame_computed_by_hand():
    truth = cars((0.0, 0.0), (10.0, 0.0), (20.0, 0.0), id=[1, 2, 3])
    tracks = cars((0.0, 0.6), (10.8, 0.0), (30.0, 0.0), id=[7, 8, 9])
    scores = Scorer().score(record([truth], [tracks]))
    assert counts(scores) == [(1, 1, 2)]
    assert per_frame(scores)["rmse_m"] == pytest.approx([np.sqrt((0.36 + 0.64) / 2)])
    assert outcomes(scores) == {
        ("truth", "matched", 1, 7),
        ("truth", "matched", 2, 8),
        ("truth", "missed", 3, -1),
        ("track", "matched", 7, 1),
        ("track", "matched", 8, 2),
        ("track", "false", 9, -1),
    }


BOX_ERRORS = ["length_error_m", "width_error_m", "heading_error_deg", "speed_error_mps", "velocity_error_mps", "iou_3d"]


def test_errors_of_sizes_headings_and_velocities_are_means_over_the_matched_pairs():
    truth = cars((0.0, 0.0), (30.0, 0.0), id=[1, 2], velocity=np.array([[10.0, 0.0, 0.0]] * 2))
    shrunk = cars((0.0, 0.0), (60.0, 0.0), id=[7, 8], velocity=np.array([[0.0, 8.0, 0.0]] * 2))
    shrunk.size[:] *= 0.6
    turned = cars((0.0, 0.0), (30.0, 0.0), id=[7, 8], yaw=np.array([1.5 * np.pi, 0.0]))
    scores = Scorer().score(record([truth, truth, truth], [shrunk, turned, NOTHING]))
    table = per_frame(scores)
    assert np.transpose([table[name] for name in BOX_ERRORS]) == pytest.approx(
        np.array(
            [
                [0.4 * 4.5, 0.4 * 1.8, 0.0, 2.0, np.hypot(10.0, 8.0), 0.6**3],
                [0.0, 0.0, 45.0, 10.0, 10.0, (1.8 / (2 * 4.5 - 1.8) + 1.0) / 2],
                [np.nan] * 6,
            ]
        ),
        nan_ok=True,
    )
    means = summary_of(scores)["ego"]["picture"]
    assert means["length_error_m"] == pytest.approx({"mean": 0.9, "std": 0.9})  # over the frames with a pair
    assert means["heading_error_deg"]["mean"] == pytest.approx(22.5)
    assert summary_of(scores, slice(2, 3))["ego"]["picture"]["iou_3d"] == {"mean": None, "std": None}


def test_errors_of_pairs_do_not_depend_on_the_block_of_frames_that_is_scored():
    truth = [cars((float(k), 0.0), (30.0, 0.0)) for k in range(6)]
    tracks = [cars((k + 0.3, 0.1), (30.0, 0.2), yaw=np.full(2, 0.1 * k)) for k in range(6)]
    whole = per_frame(Scorer().score(record(truth, tracks)))
    blocks = [per_frame(Scorer().score(record(truth[part], tracks[part]))) for part in (slice(4), slice(4, 6))]
    for name in BOX_ERRORS:
        assert np.concatenate([block[name] for block in blocks]).tolist() == whole[name].tolist()


def test_errors_of_height_count_in_three_dimensions_only():
    """A track on the wrong level of a bridge is false, and its object is missed."""
    truth, tracks = cars((0.0, 0.0), (10.0, 0.0), id=[1, 2]), cars((0.6, 0.0), (10.0, 0.0), id=[7, 8])
    tracks.position[:, 2] += [0.8, 5.0]
    run = record([truth], [tracks])
    flat = Scorer().score(run)
    assert counts(flat) == [(0, 0, 2)]
    assert per_frame(flat)["rmse_m"] == pytest.approx([np.sqrt(0.36 / 2)])
    solid = Scorer(assigner=CenterDistanceAssigner(dimensions=3), distance=SetDistance(dimensions=3)).score(run)
    assert counts(solid) == [(1, 1, 1)]
    assert per_frame(solid)["rmse_m"] == pytest.approx([1.0])
    assert per_frame(solid)["ospa_m"] == pytest.approx([np.sqrt((1.0 + 25.0) / 2)])
    assert per_frame(flat)["ospa_m"] == pytest.approx([np.sqrt(0.36 / 2)])


@pytest.mark.parametrize(
    ("ignore_unseen", "expected", "outcome"), [(False, (0, 1, 0), "false"), (True, (0, 0, 0), "unevaluated")]
)
def test_a_track_of_an_unseen_object_is_false_by_default(ignore_unseen, expected, outcome):
    run = record([cars((0.0, 0.0), id=[5])], [cars((0.5, 0.0), id=[7])], points=[[0]])
    scores = Scorer(ignore_unseen=ignore_unseen).score(run)
    assert counts(scores) == [expected]
    assert {o for kind, o, _, _ in outcomes(scores) if kind == "track"} == {outcome}


def test_an_unseen_object_excuses_one_track_only():
    run = record([cars((0.0, 0.0))], [cars((0.5, 0.0), (-0.5, 0.0))], points=[[0]])
    assert counts(Scorer(ignore_unseen=True).score(run)) == [(0, 1, 0)]


def test_the_agent_is_in_its_own_truth_by_default():
    run = record([cars((0.0, 0.0), (9.0, 0.0), id=[42, 1])], [cars((0.1, 0.0), (9.0, 0.0))], own=42)
    assert counts(Scorer().score(run)) == [(0, 0, 2)]
    assert counts(Scorer(include_self=False).score(run)) == [(0, 0, 1)]


def test_a_switch_is_counted_against_the_last_match_even_after_a_gap():
    truth = [cars((0.0, 0.0), id=[1])] * 6
    there, absent = (0.0, 0.0), (50.0, 0.0)
    tracks = [cars(p, id=[i]) for p, i in ((there, 7), (there, 7), (absent, 7), (there, 8), (there, 8), (there, 7))]
    assert Scorer().score(record(truth, tracks)).id_switches.tolist() == [[0, 0, 0, 1, 0, 1]]


@pytest.mark.parametrize("scored", [slice(9, 5), slice(0, 0), slice(3, 3)])
def test_without_scored_frames_the_summary_is_empty(scored):
    truth = [cars((0.0, 0.0))] * 5
    assert summary(truth, truth, scored)["fn"] == {"mean": None, "std": None}


def test_the_first_of_several_messages_about_a_frame_counts_as_in_the_broker():
    run = record([cars((0.0, 0.0))], [cars((0.0, 0.0))])
    run.add(0, [Series("", "picture")], Snapshot.of(NOTHING))
    assert counts(Scorer().score(run)) == [(0, 0, 1)]


def test_estimates_with_the_same_messages_are_scored_once_and_are_in_all_tables():
    run = recorded([cars((0.0, 0.0))] * 3, {})
    for frame in range(3):
        run.add(frame, [Series("ego", "local"), Series("ego", "received")], Snapshot.of(cars((0.1, 0.0))))
    scores = Scorer().score(run)
    assert scores.series == (("ego", "local"),)
    assert scores.same_as == {("ego", "received"): ("ego", "local")}
    assert counts(scores, estimator="received") == counts(scores, estimator="local") == [(0, 0, 1)] * 3
    assert summary_of(scores)["ego"]["received"] == summary_of(scores)["ego"]["local"]
    assert set(scores.objects()["estimator"]) == {"local"}


def test_an_estimate_that_differs_in_one_frame_is_scored_separately():
    run = recorded([cars((0.0, 0.0))] * 3, {})
    for frame in range(3):
        both = [Series("ego", "local"), Series("ego", "received")][: 1 if frame == 1 else 2]
        run.add(frame, both, Snapshot.of(cars((0.1, 0.0))))
    scores = Scorer().score(run)
    assert not scores.same_as
    assert counts(scores, estimator="received") == [(0, 0, 1), (1, 0, 0), (0, 0, 1)]


def test_the_picture_on_arrival_is_the_newest_received_one_until_it_is_too_old():
    run = recorded([cars((float(frame), 0.0)) for frame in range(12)], {})
    for frame, step in ((0, 1), (1, 3), (2, 2), (3, 4)):  # the picture of frame 1 is overtaken by that of frame 2
        run.add(frame, [Series("ego", "picture_received")], Snapshot.of(cars((float(frame), 0.0))), step, frame * 100)
    run.hold_pictures({"ego": 400}, {frame: 100 * frame for frame in range(12)})
    frames = np.arange(12)
    held = run.tracks([Series("ego", "picture_on_arrival")], frames)
    place = dict(zip(held.boxes.group.tolist(), held.boxes.position[:, 0].tolist(), strict=True))
    assert place == {1: 0.0, 2: 2.0, 3: 2.0, 4: 3.0, 5: 3.0, 6: 3.0, 7: 3.0}


def test_the_age_of_the_picture_on_arrival_follows_from_the_time_in_its_header():
    run = recorded([cars((float(frame), 0.0)) for frame in range(6)], {})
    for frame, time_ns in ((0, 0), (1, -300), (2, 500)):  # restamped into the past, and into the future
        run.add(frame, [Series("ego", "picture_received")], Snapshot.of(cars((float(frame), 0.0))), frame, time_ns)
    run.hold_pictures({"ego": 200}, {frame: 100 * frame for frame in range(6)})
    held = run.tracks([Series("ego", "picture_on_arrival")], np.arange(6))
    assert held.boxes.group.tolist() == [0, 5]


def test_rmse_covers_all_pairs_of_the_run_and_is_null_without_any():
    truth = [cars((0.0, 0.0), (9.0, 0.0)), cars((0.0, 0.0))]
    scores = Scorer().score(record(truth, [cars((0.3, 0.0), (9.0, 0.4)), cars((0.0, 1.2))]))
    assert summary_of(scores)["ego"]["picture"]["rmse_m"] == pytest.approx(np.sqrt((0.09 + 0.16 + 1.44) / 3))
    none = Scorer().score(record(truth, [NOTHING] * 2))
    assert summary_of(none)["ego"]["picture"]["rmse_m"] is None
    assert np.isnan(per_frame(none)["rmse_m"]).all()
    json.dumps(summary_of(none), allow_nan=False)


def test_the_summary_can_cover_some_frames_while_tables_have_all():
    scores = Scorer().score(record([cars((0.0, 0.0))] * 4, [NOTHING, *[cars((0.0, 0.6))] * 3]))
    numbers = summary_of(scores, slice(1, 4))["ego"]["picture"]
    assert (numbers["fn"]["mean"], numbers["tp"]["mean"], numbers["rmse_m"]) == (0.0, 1.0, pytest.approx(0.6))
    assert len(per_frame(scores)["frame"]) == 4


def test_matching_by_overlap_can_be_configured():
    truth, tracks = [cars((0.0, 0.0))], [cars((0.0, 1.5))]
    assert counts(Scorer().score(record(truth, tracks))) == [(0, 0, 1)]
    assert counts(Scorer(assigner=IoU3DGreedyAssigner()).score(record(truth, tracks))) == [(1, 1, 0)]


def test_truth_that_does_not_match_the_agents_is_refused():
    run = Record(["ego", "infra_1"])
    with pytest.raises(ValueError, match=r"shape \(1, 1\)"):
        run.add_truth(3, cars((0.0, 0.0)), np.array([[9]]), np.zeros((2, 3)), np.array([-1, -1]))
    with pytest.raises(ValueError, match="found agent 'infra_9'"):
        run.add(3, [Series("infra_9", "local")], Snapshot.of(cars((0.0, 0.0))))


def test_a_record_without_truth_has_no_frames():
    assert summary_of(Scorer().score(Record(["ego"]))) == {}


FIRST, SECOND, AWAY = (0.0, 0.0), (10.0, 0.0), (40.0, 0.0)


def test_precision_recall_and_mota_count_all_scored_frames_together() -> None:
    truth = [cars(FIRST, SECOND)] * 4
    # 5 pairs, 3 missed objects, 1 false track, and one identity switch: track 3 takes over the first object.
    picture = [cars(FIRST, SECOND, id=[1, 2]), cars(FIRST, id=[1]), cars(FIRST, AWAY, id=[3, 4]), cars(FIRST, id=[3])]
    numbers = summary(truth, picture)
    assert numbers["precision"] == pytest.approx(5 / 6)
    assert numbers["recall"] == pytest.approx(5 / 8)
    assert numbers["mota"] == pytest.approx(1 - (3 + 1 + 1) / 8)
    numbers = summary(truth, picture, slice(0, 2))
    assert (numbers["precision"], numbers["recall"], numbers["mota"]) == (1.0, 0.75, 0.75)


@pytest.mark.parametrize(
    ("truth", "picture", "expected"),
    [
        (cars(FIRST), cars(SECOND, AWAY), [0.0, 0.0, -2.0]),
        (NOTHING, NOTHING, [None, None, None]),
        (cars(FIRST), NOTHING, [None, 0.0, 0.0]),
    ],
    ids=["more errors than objects", "without objects or tracks", "without tracks"],
)
def test_precision_recall_and_mota_at_their_limits(truth: ObjectStates, picture: ObjectStates, expected: list) -> None:
    numbers = summary([truth], [picture])
    assert [numbers[name] for name in ("precision", "recall", "mota")] == expected


BOTH, ONE = cars((0.0, 0.0), (20.0, 0.0), id=[1, 2]), cars((0.0, 0.0), id=[1])


@pytest.mark.parametrize(
    ("truth", "picture", "scored", "share"),
    [
        ([BOTH] * 4, [BOTH, ONE, ONE, NOTHING], slice(None), (3 / 4 + 1 / 4) / 2),
        ([BOTH, ONE, ONE, ONE], [ONE] * 4, slice(None), (1.0 + 0.0) / 2),
        ([BOTH] * 4, [NOTHING, BOTH, BOTH, NOTHING], slice(1, 3), 1.0),
        ([NOTHING] * 2, [ONE] * 2, slice(None), None),
    ],
    ids=["the matched share", "of equal weight however long seen", "in scored frames", "none without objects"],
)
def test_completeness_is_the_mean_over_objects_of_their_matched_share(truth, picture, scored, share) -> None:
    assert summary(truth, picture, scored)["completeness"] == (share if share is None else pytest.approx(share))


def test_set_distances_are_computed_per_frame_and_summarised_like_counts() -> None:
    numbers, half = summary([BOTH, BOTH], [BOTH, ONE]), pytest.approx(np.sqrt(25 / 2) / 2)
    assert numbers["ospa_m"] == {"mean": half, "std": half}
    assert numbers["gospa_m"]["mean"] == half


def random_run(seed: int, shuffled: bool = False) -> tuple[Record, list]:
    """A run of three agents with two estimators each and a picture, in clutter."""
    rng = np.random.default_rng(seed)
    shuffle = np.random.default_rng(seed + 1)
    agents, frames = ["ego", "infra_1", "infra_2"], []
    run = Record(agents)
    for _ in range(4):
        n = int(rng.integers(0, 6))

        def some(k, rng=rng):
            return cars(*rng.uniform(-6.0, 6.0, (k, 2)), id=rng.permutation(9)[:k])

        truth, points = some(n), rng.integers(0, 9, (n, 3))
        place, own = rng.uniform(-4.0, 4.0, (3, 3)), rng.integers(-1, 9, 3)
        tracks = {(a, e): some(int(rng.integers(0, 5))) for a in agents for e in ("local", "mission")}
        tracks["", "picture"] = some(int(rng.integers(0, 6)))
        frames.append((truth, points, place, own, tracks))
    order = shuffle.permutation(4) if shuffled else range(4)
    for frame in order:
        truth, points, place, own, tracks = frames[frame]
        rows = shuffle.permutation(len(truth)) if shuffled else np.arange(len(truth))
        run.add_truth(int(frame), truth.select(rows), points[rows], place, own)
        for (agent, estimator), states in tracks.items():
            mixed = states.select(shuffle.permutation(len(states))) if shuffled else states
            run.add(int(frame), [Series(agent, estimator)], Snapshot.of(mixed))
    return run, frames


@given(st.integers(0, 10**6), st.booleans(), st.booleans())
def test_counts_equal_plain_loops(seed, include_self, ignore_unseen):
    run, frames = random_run(seed)
    scorer = Scorer(range_m=7.0, min_points=5, include_self=include_self, ignore_unseen=ignore_unseen)
    table = per_frame(scorer.score(run))
    place = {name: k for k, name in enumerate(("ego", "infra_1", "infra_2"))}
    assert len(table["frame"]) == 3 * 3 * 4
    for k in range(len(table["frame"])):
        truth, points, position, own, tracks = frames[table["frame"][k]]
        agent, estimator = str(table["agent"][k]), str(table["estimator"][k])
        a = place[agent]
        states = tracks["" if estimator == "picture" else agent, estimator]
        judged, other, heard = [], [], []
        for row in range(len(truth)):
            near = np.hypot(*(truth.position[row, :2] - position[a, :2])) <= 7.0
            is_own = truth.id[row] == own[a]
            if near and max(points[row]) >= 5 and (include_self or not is_own):
                judged.append(truth.position[row, :2])
            elif ignore_unseen or (is_own and not include_self):
                other.append(truth.position[row, :2])
        for row in range(len(states)):
            if np.hypot(*(states.position[row, :2] - position[a, :2])) <= 7.0:
                heard.append(states.position[row, :2])

        def distances(x, y):
            return np.array([[np.hypot(*(p - q)) for q in y] for p in x]).reshape(len(x), len(y))

        tp, least = best_pairs(distances(judged, heard), 2.0)
        assert (table["fn"][k], table["tp"][k]) == (len(judged) - tp, tp)
        if not other:
            assert table["fp"][k] == len(heard) - tp
        else:
            assert len(heard) - tp - len(other) <= table["fp"][k] <= len(heard) - tp
        if tp == 1:
            assert table["rmse_m"][k] == pytest.approx(least)


@given(st.integers(0, 10**6))
def test_neither_the_order_of_rows_nor_of_messages_matters(seed):
    straight = Scorer(range_m=7.0, ignore_unseen=True).score(random_run(seed)[0])
    shuffled = Scorer(range_m=7.0, ignore_unseen=True).score(random_run(seed, shuffled=True)[0])
    assert json.dumps(summary_of(straight)) == json.dumps(summary_of(shuffled))
    for name, column in straight.objects().items():
        assert np.array_equal(column, shuffled.objects()[name], equal_nan=column.dtype.kind == "f"), name


@given(st.integers(0, 10**6))
def test_every_box_has_one_outcome_and_outcomes_add_up_to_the_counts(seed):
    scores = Scorer(range_m=7.0).score(random_run(seed)[0])
    t, counted = scores.objects(), per_frame(scores)
    for k in range(len(counted["frame"])):
        selected = np.all([t[name] == counted[name][k] for name in ("frame", "agent", "estimator")], axis=0)

        def number(kind, outcome, selected=selected):
            return int(np.sum(selected & (t["kind"] == kind) & (t["outcome"] == outcome)))

        assert number("truth", "missed") == counted["fn"][k]
        assert number("track", "false") == counted["fp"][k]
        assert number("truth", "matched") == number("track", "matched") == counted["tp"][k]
