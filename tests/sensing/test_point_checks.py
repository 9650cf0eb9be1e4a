"""Checks of detections against points find phantoms that let light through, and pass real cars."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from made_scans import HEIGHT_M, Street, boxes

from mast_zenoh.attacks import point_phantoms, spoofers
from mast_zenoh.sensing.point_checks import OcclusionCheck, PointCheck, ShadowCheck, TemporalCheck
from mast_zenoh.sensing.points import Points

CHECKS: tuple[Callable[[], PointCheck], ...] = (OcclusionCheck, ShadowCheck, TemporalCheck)
#: Middle of the usual phantom, m.
PHANTOM = np.array([[6.5 + 2.25, 0.0, -HEIGHT_M + 0.75]])


def phantom(model: str, frame: int, attack: point_phantoms.InjectedPoints) -> Points:
    street = Street(np.array([[25.0, 6.0, 0.0, 0.0]]), model, wall_x=60.0)
    return attack.forge_points(frame, frame * 100_000_000, street.points(0.1 * frame, frame), street.lidar(0.0))


def injection(points: int, occlusion: bool) -> point_phantoms.InjectedPoints:
    place = spoofers.Following(aim_deg=0.0, lag_s=0.0)
    attack = point_phantoms.SunInjection(start_s=0.1, place=place, points=points, occlusion=occlusion)
    attack.bind(1, "a")
    return attack


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("model", ["OS1-128", "VLP-32C", "VLP-16", "AT128"])
def test_a_phantom_that_ignores_occlusion_is_refused(check: Callable[[], PointCheck], model: str) -> None:
    attack, judge = injection(200, occlusion=False), check()
    assert judge.keep(phantom(model, 0, attack), boxes(np.zeros((0, 3)))).tolist() == []
    for frame in (1, 2, 3):
        assert not judge.keep(phantom(model, frame, attack), boxes(PHANTOM)).any()


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("model", ["OS1-128", "VLP-16"])
def test_at_most_a_few_percent_of_real_cars_are_refused(check: Callable[[], PointCheck], model: str) -> None:
    kept = []
    for seed in range(5):
        draw = np.random.default_rng(seed)
        places = np.array([(x, y) for x in (-30.0, -12.0, 12.0, 30.0) for y in (-14.0, -6.0, 6.0, 14.0)])
        cars = np.column_stack(
            [places + draw.uniform(-2.5, 2.5, (16, 2)), draw.uniform(-3, 3, 16), draw.uniform(0, 12, 16)]
        )
        street, judge = Street(cars, model, speed=draw.uniform(0.0, 12.0), turn=draw.uniform(-0.2, 0.2)), check()
        for frame in range(5):
            detections = street.detections(0.1 * frame, 10 * seed + frame)
            kept += judge.keep(street.points(0.1 * frame, 10 * seed + frame), detections).tolist()
    assert len(kept) > 200
    assert np.mean(kept) > 0.95


def test_a_phantom_on_all_beams_passes_single_scans_but_not_the_free_street_before_it() -> None:
    attack = injection(9999, occlusion=True)
    judges = [check() for check in CHECKS]
    for frame in range(3):
        scan = phantom("OS1-128", frame, attack)
        kept = [bool(judge.keep(scan, boxes(PHANTOM).select(slice(int(frame > 0)))).all()) for judge in judges]
    assert kept == [True, True, False]


def test_an_object_that_goes_on_or_comes_out_of_cover_is_plausible_and_doubt_is_forgiven() -> None:
    street = Street(np.array([[20.0, 2.0, 0.0, 8.0]]), "OS1-128")
    judge = TemporalCheck()
    for frame in range(6):
        detections = street.detections(0.1 * frame, frame)
        assert judge.keep(street.points(0.1 * frame, frame), detections).all()
    hidden = Street(np.array([[10.0, 0.0, 1.57, 0.0], [22.0, 0.0, 0.0, 0.0]]), "OS1-128")
    judge = TemporalCheck()
    judge.check(hidden.points(), boxes(np.array([[10.0, 0.0, -1.05]])))
    assert judge.keep(hidden.points(0.1), boxes(np.array([[10.0, 0.0, -1.05], [22.0, 0.0, -1.05]]))).all()
    judge, empty = TemporalCheck(forgive=3), Street(np.zeros((0, 4)), "OS1-128")
    judge.check(empty.points(), boxes(np.zeros((0, 3))))
    seen = [bool(judge.keep(empty.points(), boxes(PHANTOM))[0]) for _ in range(6)]
    assert seen == [False, False, False, False, True, True]


@pytest.mark.parametrize("check", CHECKS)
def test_without_points_or_detections_nothing_is_refused(check: Callable[[], PointCheck]) -> None:
    judge = check()
    assert judge.check(Points.empty(), boxes(np.zeros((0, 3)))).shape == (0,)
    assert judge.keep(Points.empty(), boxes(PHANTOM)).tolist() == [True]
    assert judge.keep(Points.empty(), boxes(np.array([[60.0, 9.0, -1.0]]))).tolist() == [True]


def test_a_threshold_outside_of_0_to_1_is_refused() -> None:
    with pytest.raises(ValueError, match="least: found 2"):
        OcclusionCheck(least=2)
