"""Who contradicts whom about an object, and the median of its tracks shows which agent is off."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_batches import Track, batch, view

from mast_zenoh.arrays.states import Floats
from mast_zenoh.integrity import disputes
from mast_zenoh.integrity.agent_fault import PRIOR, displacements
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.offsets import Offsets, OffsetSums, offsets
from mast_zenoh.integrity.sequential import EXPLAINED

EVERYBODY = np.ones(3, np.bool_)
CORNERS = {"a": (-20.0, 0.0), "b": (20.0, 0.0), "c": (0.0, 20.0)}


def statements(
    tracks: list[Track],
    blocked: dict[str, list[tuple[float, float, float]]],
    corners: dict[str, tuple[float, float]] = CORNERS,
    suspended: str = "",
) -> disputes.Testimonies:
    """What the agents at some corners say; blocked: what each sees; suspended: the name of one, or none."""
    views = {name: view(place, *blocked.get(name, [])) for name, place in corners.items()}
    given = batch(tracks, tuple(corners), views)
    voter = np.array([name != suspended for name in given.agents])
    return disputes.Evidence.of(given, voter).testimonies


CAR_AT_ORIGIN = (0.0, 0.0, 2.3)


def test_each_that_sees_through_an_object_contradicts_the_one_that_reports_it() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN]})
    assert found.between.tolist() == [[0, 1, 1], [1, 0, 0], [1, 0, 0]]
    assert found.accusations(EVERYBODY)[0].tolist() == [[True, False, False]]
    assert not found.against_itself.any()


def test_an_agent_that_sees_through_what_two_report_is_contradicted_and_not_accused() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0))]
    found = statements(tracks, {"a": [CAR_AT_ORIGIN], "b": [CAR_AT_ORIGIN]})
    assert found.between.tolist() == [[0, 0, 1], [0, 0, 1], [1, 1, 0]]
    assert not found.accusations(EVERYBODY)[:, :, 2].any()


def test_an_agent_that_lies_in_any_case_accuses_nobody_and_is_contradicted() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN], "c": [CAR_AT_ORIGIN]})
    assert found.accusations(EVERYBODY)[0].tolist() == [[True, False, False]]
    assert not found.accusations(np.array([True, False, True])).any()
    assert found.between.tolist() == [[0, 1, 0], [1, 0, 0], [0, 0, 0]]


def test_what_a_suspended_agent_sees_through_contradicts_nobody() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN]}, suspended="b")
    assert found.between.tolist() == [[0, 0, 1], [0, 0, 0], [1, 0, 0]]
    alone = {"a": [CAR_AT_ORIGIN], "c": [CAR_AT_ORIGIN]}
    both: list[Track] = [("a", 0, (0.0, 0.0)), ("c", 0, (0.0, 0.0))]
    assert not statements(both, alone, suspended="b").accusations(EVERYBODY).any()


def test_silence_about_a_visible_object_contradicts_two_that_report_it() -> None:
    seen = {name: [CAR_AT_ORIGIN] for name in CORNERS}
    elsewhere: Track = ("c", 1, (60.0, 60.0))
    assert not statements([("a", 0, (0.0, 0.0)), elsewhere], seen).silent.any(), "one may be wrong"
    two: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0)), elsewhere]
    assert statements(two, seen).silent[0].tolist() == [False, False, True]


@pytest.mark.parametrize(("hidden_by", "noted"), [(CAR_AT_ORIGIN, True), ((2.2, -1.5, 1.6), False)])
def test_silence_counts_only_where_the_rays_end(hidden_by: tuple[float, float, float], noted: bool) -> None:
    tracks: list[Track] = [(name, 0, (0.0, 0.0)) for name in "abd"]
    # Something beside the object hides part of it from `c`, which thus neither sees through it nor sees it.
    blocked = {name: [CAR_AT_ORIGIN] for name in "abd"} | {"c": [hidden_by]}
    found = statements(tracks, blocked, CORNERS | {"d": (0.0, -20.0)})
    assert found.silent[0].tolist() == [False, False, noted, False]
    assert not found.denies.any()


def test_two_that_report_a_small_object_as_a_large_one_do_not_make_others_silent_about_it() -> None:
    seen = {name: [CAR_AT_ORIGIN] for name in CORNERS}
    agents = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0)), ("c", 1, (60.0, 60.0))]
    views = {name: view(place, *seen[name]) for name, place in CORNERS.items()}
    given = batch(agents, tuple(CORNERS), views)
    for smallest, silent in ((1.5, True), (0.3, False)):
        size = given.states.size.copy()
        size[0] = smallest
        smaller = replace(given, states=given.states.with_(size=size))
        assert disputes.Evidence.of(smaller, EVERYBODY).testimonies.silent[0, 2] == silent


def test_a_claim_in_space_that_its_own_sensor_sees_through_contradicts_itself() -> None:
    found = statements([("a", 0, (0.0, 0.0))], {})
    assert found.against_itself.tolist() == [1, 0, 0]
    assert not found.claims.any()
    assert not found.between.any()


def test_the_offset_of_one_of_three_is_seen_in_its_own_track() -> None:
    given = batch([("a", 0, (0.0, 0.0)), ("b", 0, (0.1, 0.0)), ("c", 0, (1.5, 0.0))], ("a", "b", "c"))
    measured = offsets(given, ClusterBoxes.of(given), np.ones(3))
    assert measured.valid.tolist() == [[True, True, True]]
    assert measured.offset[0, :, 0] == pytest.approx([-0.1, 0.0, 1.4])


@pytest.mark.parametrize("others", [[], [("a", 1, (2.0, 0.0)), ("b", 1, (2.0, 0.0)), ("c", 1, (2.0, 0.0))]])
def test_two_tracks_and_crowded_objects_have_no_middle(others: list[Track]) -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.1, 0.0))]
    tracks += [("c", 0, (0.0, 0.1))] if others else []
    given = batch([*tracks, *others], ("a", "b", "c"))
    assert not offsets(given, ClusterBoxes.of(given), np.ones(3)).valid.any()


def offsets_of(moved: Floats, random: np.random.Generator) -> OffsetSums:
    """Sums of the offsets of an agent from twelve objects that are moved by (12, 2) m, over three seconds."""
    sums = OffsetSums(5.0)
    information = np.tile(np.eye(2) / 0.05, (12, 1, 1, 1))
    for frame in range(30):
        offset = (moved + random.normal(0.0, 0.2, (12, 2)))[:, None]
        sums.of_objects(frame * 100_000_000, np.zeros(1, np.int64), np.arange(12), Offsets(SEEN, offset, information))
    return sums


SEEN = np.ones((12, 1), np.bool_)


@pytest.mark.parametrize("seed", range(5))
def test_an_offset_is_a_lie_as_far_as_no_fault_of_the_agent_explains_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    arm, velocity = random.uniform(-50.0, 50.0, (12, 2)), random.uniform(-12.0, 12.0, (12, 2))
    design, prior = displacements(arm, velocity), np.diag(1.0 / PRIOR) / 0.11
    for fault in ([1.0, -0.5, 0.0, 0.0], [0.0, 0.0, 0.03, 0.0], [0.0, 0.0, 0.0, 0.2]):
        moved = design @ fault
        worst = int(np.hypot(*moved.T).argmax())
        sums = offsets_of(moved, random)
        assert sums.beyond_fault(0, np.arange(12), worst, design, prior) < 0.5 * EXPLAINED
    one = np.zeros((12, 2))
    one[4] = 1.0, 0.0
    assert offsets_of(one, random).beyond_fault(0, np.arange(12), 4, design, prior) > EXPLAINED
