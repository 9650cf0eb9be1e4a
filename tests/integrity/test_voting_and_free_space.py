"""`KOfN`, `FreeSpace` and `FreeSpaceVeto`: objects that too few report, or that agents see through, are withheld."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_batches import CAR, Track, batch, view

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.fusion.pipelines import FreeSpaceVeto, MissionEstimator, PictureFirst
from mast_zenoh.integrity import Batch, FreeSpace, Integrity, KOfN, SweptView
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.memory import BetaReputation
from mast_zenoh.integrity.visibility import seen_through

AGENTS = ("a", "b", "c", "d")
PLACES = {"a": (-20.0, 0.0), "b": (20.0, 0.0), "c": (0.0, 20.0), "d": (0.0, -20.0)}
#: All see through the origin, or the rays of all end there.
EMPTY = {name: view(place) for name, place in PLACES.items()}
FULL = {name: view(place, (0.0, 0.0, 2.6)) for name, place in PLACES.items()}


def at_origin(*names: str) -> list[Track]:
    return [(name, 0, (0.0, 0.0)) for name in names]


def withheld(stage: Integrity, *batches: Batch) -> bool:
    for each in batches:
        assessment = stage.assess(each)
    return bool(assessment.objects.withheld[0])


def looking(name: str, distance_m: float) -> dict:
    return {"a": FULL["a"], name: view((distance_m, 0.0), (0.0, 0.0, 2.0))}


HIDDEN = {"a": FULL["a"], "b": view(PLACES["b"], (10.0, 0.0, 2.0))}
DECISIONS = {
    "one of four": (KOfN, {}, "a", FULL, True),
    "two of four": (KOfN, {}, "ab", FULL, False),
    "two of four, and three are needed": (KOfN, dict(k=3), "ab", FULL, True),
    "both that should see it": (KOfN, dict(k=3), "ab", {"a": FULL["a"]}, False),
    "the only one that should see it": (KOfN, {}, "a", {"a": FULL["a"]}, False),
    "two for, one against": (KOfN, {}, "ab", {**FULL, "d": EMPTY["d"]}, True),
    "three for, one against": (KOfN, {}, "abc", {**FULL, "d": EMPTY["d"]}, False),
    "hidden from the other": (KOfN, {}, "a", HIDDEN, False),
    "too far from the other": (KOfN, {}, "a", looking("b", 75.0), False),
    "near the other": (KOfN, {}, "a", looking("b", 60.0), True),
    "one against three that see through it": (FreeSpace, {}, "a", {**EMPTY, "a": FULL["a"]}, True),
    "its own view contradicts it": (FreeSpace, {}, "a", {"a": EMPTY["a"]}, True),
    "rays end at it": (FreeSpace, {}, "a", FULL, False),
    "a tie": (FreeSpace, {}, "ab", {"c": EMPTY["c"], "d": EMPTY["d"]}, False),
    "more witnesses than liars": (FreeSpace, {}, "ab", {"a": FULL["a"], "b": FULL["b"], "c": EMPTY["c"]}, False),
    "a vote without views": (KOfN, {}, "a", {}, False),
    "free space without views": (FreeSpace, {}, "a", {}, False),
}


@pytest.mark.parametrize(("stage", "parameters", "reporters", "views", "expected"), DECISIONS.values(), ids=DECISIONS)
def test_an_object_is_withheld_if_too_few_report_it_or_more_see_through_it(
    stage: type[Integrity], parameters: dict, reporters: str, views: dict, expected: bool
) -> None:
    judge = stage(**parameters)
    assert withheld(judge, batch(at_origin(*reporters), AGENTS, views)) is expected
    assert judge.assess(batch([], AGENTS, frame=1)).objects.trust.shape == (0,)


def test_small_objects_are_expected_at_the_range_at_which_they_have_as_many_returns_as_a_car() -> None:
    boxes = ClusterBoxes(
        np.zeros((3, 3)), np.zeros((3, 3)), np.array([[4.5, 1.8, 1.5], [0.5, 0.45, 1.5], [12.0, 2.5, 3.0]]), np.zeros(3)
    )
    assert boxes.sight_range(70.0) == pytest.approx([70.0, 35.0, 70.0])


def test_a_dispute_between_two_agents_counts_against_neither() -> None:
    stage = FreeSpace()
    views = {"a": FULL["a"], "b": EMPTY["b"]}
    for frame in range(20):
        assessment = stage.assess(batch(at_origin("a"), AGENTS, views, frame=frame))
    assert assessment.objects.withheld.tolist() == [False]
    assert assessment.agents.mean.tolist() == [0.5] * 4


def test_silence_about_occupied_space_is_evidence_of_a_removal() -> None:
    stage, honest = FreeSpace(), FreeSpace()
    for frame in range(21):
        assessment = stage.assess(batch(at_origin("a", "b"), AGENTS, FULL, frame=frame))
        reference = honest.assess(batch(at_origin("a", "b", "c"), AGENTS, FULL, frame=frame))
    # In two seconds, one object is silently removed: 0 upheld and about 2 refuted claims.
    assert assessment.agents.mean[2] == pytest.approx(1.0 / 4.0, abs=0.01)
    assert assessment.agents.mean[0] > 0.7
    assert reference.agents.mean[2] > 0.7
    assert assessment.objects.confirming.tolist() == [4], "rays that end at the object are for it"


def test_one_claim_accuses_nobody_of_a_removal() -> None:
    stage = FreeSpace()
    for frame in range(20):
        assessment = stage.assess(batch(at_origin("a"), AGENTS, FULL, frame=frame))
    assert assessment.agents.mean[1:].tolist() == [0.5] * 3


def test_a_claim_in_the_agents_own_free_space_is_left_out_of_the_fusion() -> None:
    assessment = FreeSpace().assess(batch(at_origin("a", "b", "c"), AGENTS, {**FULL, "c": EMPTY["c"]}))
    assert assessment.weights is not None
    assert assessment.weights.tolist() == [1.0, 1.0, 0.0]
    alone = FreeSpace().assess(batch(at_origin("c"), AGENTS, {"c": EMPTY["c"]}))
    assert alone.weights is not None
    assert alone.weights.tolist() == [1.0], "a withheld object is tracked on"


def test_a_phantom_stays_withheld_where_nobody_can_tell_any_more() -> None:
    seen = [batch(at_origin("a"), AGENTS, {**EMPTY, "a": FULL["a"]}, frame=frame) for frame in range(10)]
    unseen = [batch(at_origin("a"), AGENTS, {"a": FULL["a"]}, frame=frame) for frame in range(10, 50)]
    assert withheld(FreeSpace(), *seen, *unseen[:10])
    assert not withheld(FreeSpace(), *seen, *unseen), "it is forgotten after some seconds"


def test_a_confirmed_object_outlasts_a_moment_of_contradiction() -> None:
    seen = [batch(at_origin("a", "b"), AGENTS, FULL, frame=frame) for frame in range(20)]
    assert not withheld(FreeSpace(), *seen, batch(at_origin("a"), AGENTS, EMPTY, frame=20))


@pytest.mark.parametrize(
    ("size", "displaced", "refuted"),
    [
        ((4.5, 1.8, 1.5), 0.8, False),
        ((4.5, 1.8, 1.5), 2.4, True),
        ((0.6, 0.6, 1.75), 0.8, False),
        ((0.6, 0.6, 1.75), 1.8, True),
    ],
)
def test_an_object_that_is_displaced_by_its_tracks_error_is_not_seen_through(size, displaced, refuted):
    half_width = 0.5 * size[1]
    views = {name: view(PLACES[name], (0.0, displaced, half_width)) for name in ("a", "b")}
    assert withheld(FreeSpace(), batch(at_origin("a"), AGENTS, views, size={0: size})) is refuted


def test_an_old_view_shows_where_an_object_was() -> None:
    old = replace(view(PLACES["d"], (-5.0, 0.0, 2.6)), age_s=0.5)
    moving = batch(at_origin("a"), AGENTS, {"d": old}, velocity={0: (10.0, 0.0)})
    assert not seen_through(ClusterBoxes.of(moving), moving.views).any()
    standing = batch(at_origin("a"), AGENTS, {"d": old})
    assert seen_through(ClusterBoxes.of(standing), standing.views).tolist() == [[False, False, False, True]]


def test_a_record_counts_an_object_once_a_second_and_forgets() -> None:
    record, names = BetaReputation(record_s=10.0), ("a", "b")
    assert record.mean(names).tolist() == [0.5, 0.5]
    upheld, refuted = np.tile([True, False], (3, 1)), np.tile([False, True], (3, 1))
    assert record.update(batch([], names), upheld, refuted).tolist() == [0.5, 0.5], "no time has passed"
    for frame in range(1, 11):
        mean = record.update(batch([], names, frame=frame), upheld, refuted)
    # 0.3 a frame, and e^-0.01 of what was: 0.3 * (1 - e^-0.1) / (1 - e^-0.01).
    counted = 0.3 * (1.0 - np.exp(-0.1)) / (1.0 - np.exp(-0.01))
    assert mean == pytest.approx([(1.0 + counted) / (2.0 + counted), 1.0 / (2.0 + counted)])
    assert record.mean(("b", "c")) == pytest.approx([1.0 / (2.0 + counted), 0.5])


def test_cluster_boxes_are_the_means_of_their_members() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (1.0, 0.5)), ("c", 1, (9.0, 9.0))]
    boxes = ClusterBoxes.of(batch(tracks, AGENTS, velocity={1: (2.0, 1.0)}))
    assert boxes.position[:, :2] == pytest.approx(np.array([[0.5, 0.25], [9.0, 9.0]]))
    assert boxes.velocity[:, :2] == pytest.approx(np.array([[0.0, 0.0], [2.0, 1.0]]))
    use = np.array([[False, True, True, True], [False] * 4])
    chosen = ClusterBoxes.of(batch(tracks, AGENTS), use)
    assert chosen.position[:, :2] == pytest.approx(np.array([[1.0, 0.5], [9.0, 9.0]])), "all, where none is to be used"


def cars(*places: tuple[float, float]) -> ObjectStates:
    return ObjectStates.of(np.array([[x, y, 0.75] for x, y in places]), size=np.tile(CAR, (len(places), 1)))


def test_objects_of_the_picture_in_own_free_space_are_left_out() -> None:
    veto = FreeSpaceVeto(mission=PictureFirst())
    picture, own = cars((20.0, 0.0), (0.0, 20.0), (0.0, 90.0)), cars((-20.0, 0.0))
    veto.look(view((0.0, 0.0), (20.0, 0.0, 2.0)))
    kept = veto.estimate(0, own, picture).position[:, :2].tolist()
    assert kept == [[20, 0], [0, 90], [-20, 0]], "the second is seen through, the third is far away"


def test_own_tracks_are_never_left_out() -> None:
    veto = FreeSpaceVeto(mission=PictureFirst())
    veto.look(view((0.0, 0.0)))
    assert veto.estimate(0, cars((20.0, 0.0)), cars()).position[:, 0].tolist() == [20]


def test_a_view_counts_for_one_estimate() -> None:
    veto, picture = FreeSpaceVeto(mission=PictureFirst()), cars((20.0, 0.0))
    assert len(veto.estimate(0, cars(), picture)) == 1, "there is no view"
    veto.look(view((0.0, 0.0)))
    assert len(veto.estimate(0, cars(), picture)) == 0
    assert len(veto.estimate(0, cars(), picture)) == 1, "the view was of the frame before"


def test_the_estimator_inside_gets_the_view_too() -> None:
    class Looking(PictureFirst):
        seen: SweptView | None = None

        def look(self, view: SweptView) -> None:
            self.seen = view

    inner = Looking()
    outer: MissionEstimator = FreeSpaceVeto(mission=inner)
    outer.look(view((0.0, 0.0)))
    assert inner.seen is not None
