"""The majority of an object's viewers settles disputes, and the median of its tracks shows who is off."""

import numpy as np
import pytest
from integrity_batches import Track, batch, view

from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.disputes import disputes
from mast_zenoh.integrity.offsets import offsets
from mast_zenoh.integrity.visibility import lenient_sightings, rays_at

CORNERS = {"a": (-20.0, 0.0), "b": (20.0, 0.0), "c": (0.0, 20.0)}


def disputed(tracks: list[Track], blocked: dict[str, list[tuple[float, float, float]]], weight: list[float]):
    """Disputes among three agents around the origin; blocked: what each sees."""
    views = {name: view(place, *blocked.get(name, [])) for name, place in CORNERS.items()}
    given = batch(tracks, tuple(CORNERS), views)
    boxes = ClusterBoxes.of(given)
    seen, own = lenient_sightings(given, boxes)
    return disputes(given, boxes, own, seen, rays_at(given, boxes, given.views), np.array(weight))


CAR_AT_ORIGIN = (0.0, 0.0, 2.3)


def test_two_that_see_through_an_object_refute_the_one_that_reports_it() -> None:
    found = disputed([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN]}, [1.0, 1.0, 1.0])
    assert found.contradicted.tolist() == [[True, False, False]]
    assert found.contradicting.tolist() == [2.0]


def test_a_dispute_of_two_agents_counts_against_neither() -> None:
    found = disputed([("a", 0, (0.0, 0.0))], {"a": [CAR_AT_ORIGIN]}, [1.0, 1.0, 0.0])
    assert not found.contradicted.any()
    assert not found.overlooked.any()


def test_an_agent_that_sees_through_what_two_report_is_refuted() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0))]
    found = disputed(tracks, {"a": [CAR_AT_ORIGIN], "b": [CAR_AT_ORIGIN]}, [1.0, 1.0, 1.0])
    assert found.overlooked.tolist() == [[False, False, True]]
    assert not found.contradicted.any()


def test_silence_about_a_visible_object_that_two_report_is_noted() -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0))]
    seen = {name: [CAR_AT_ORIGIN] for name in CORNERS}
    found = disputed([*tracks, ("c", 1, (60.0, 60.0))], seen, [1.0, 1.0, 1.0])
    assert found.silent[0].tolist() == [False, False, False]  # two viewers that vote: no third
    more = disputed([*tracks, ("c", 1, (60.0, 60.0))], {**seen, "c": []}, [1.0, 1.0, 1.0])
    assert more.overlooked[0].tolist() == [False, False, True]


def test_liars_that_report_what_they_cannot_see_accuse_nobody() -> None:
    walls = {"a": [(-10.0, 0.0, 5.0)], "b": [(10.0, 0.0, 5.0)], "c": [CAR_AT_ORIGIN]}
    seen: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.0, 0.0))]
    hidden = disputed(seen, walls, [1.0, 1.0, 1.0])
    assert hidden.confirming.tolist() == [0.0]
    assert not hidden.silent.any()
    assert disputed(seen, {name: [CAR_AT_ORIGIN] for name in CORNERS}, [1.0, 1.0, 1.0]).confirming.tolist() == [2.0]


@pytest.mark.parametrize(("hidden_by", "noted"), [(CAR_AT_ORIGIN, True), ((2.2, -1.5, 1.6), False)])
def test_silence_counts_only_where_the_rays_end(hidden_by: tuple[float, float, float], noted: bool) -> None:
    corners = CORNERS | {"d": (0.0, -20.0)}
    tracks: list[Track] = [(name, 0, (0.0, 0.0)) for name in "abd"]
    # Something beside the object hides part of it from `c`, which thus neither sees through it nor sees it.
    blocked = {name: [CAR_AT_ORIGIN] for name in "abd"} | {"c": [hidden_by]}
    given = batch(tracks, tuple(corners), {name: view(place, *blocked[name]) for name, place in corners.items()})
    boxes = ClusterBoxes.of(given)
    seen, own = lenient_sightings(given, boxes)
    assert seen.in_view[0, 2]
    found = disputes(given, boxes, own, seen, rays_at(given, boxes, given.views), np.ones(4))
    assert found.silent[0].tolist() == [False, False, noted, False]
    assert not found.overlooked.any()


def test_a_claim_in_space_that_its_own_sensor_sees_through_confirms_nothing() -> None:
    found = disputed([("a", 0, (0.0, 0.0))], {}, [1.0, 1.0, 1.0])
    assert found.inconsistent.tolist() == [[True, False, False]]
    assert found.confirming.tolist() == [0.0]


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
