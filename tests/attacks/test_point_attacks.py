"""Attacks on points keep to their physical budget, and to what a spoofer can reach, see and hit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_scans import CAR, HEIGHT_M, Street
from tiny_world import Run, tiny

from mast_zenoh.arrays.states import Floats
from mast_zenoh.attacks import Attack, PassThrough, PointAttack, Surroundings, point_attacks, point_phantoms, spoofers
from mast_zenoh.sensing.points import Points
from mast_zenoh.sensing.sectors import chords

#: Aims without error.
SURE: dict[str, Any] = dict(aim_deg=0.0, lag_s=0.0)
AHEAD = spoofers.Following(**SURE)
EMPTY = Street(np.zeros((0, 4)), "VLP-16", wall_x=60.0)


def attacked(attack: Attack, street: Street, frames: int = 1, seed: int = 1, name: str = "a") -> tuple[Points, Points]:
    """The last of so many scans, 0.1 s apart, before and after."""
    attack.bind(seed, name)
    for frame in range(frames):
        before = street.points(0.1 * frame, frame)
        after = attack.forge_points(frame, frame * 100_000_000, before, street.lidar(0.1 * frame))
    return before, after


def moved(before: Points, after: Points) -> tuple[Points, Points]:
    """The returns of `after` that are not in `before`, and those of `before` on their beams."""
    keys, order = before.keys(), np.argsort(before.keys())
    row = order[np.minimum(np.searchsorted(keys[order], after.keys()), len(keys) - 1)]
    known = keys[row] == after.keys()
    new = ~known | (before.position[row] != after.position).any(axis=1)
    return after.select(new), before.select(row[new & known])


def share(attack: PointAttack, street: Street, frames: int) -> float:
    """Share of scans that changed."""
    attack.bind(3, "a")
    scan, changed = street.points(), 0
    for frame in range(frames):
        changed += attack.forge_points(frame, frame * 100_000_000, scan, street.lidar(0.1 * frame)) is not scan
    return changed / frames


def test_by_default_an_attack_passes_on_the_scan_itself() -> None:
    scan = EMPTY.points()
    assert PassThrough().forge_points(0, 0, scan, EMPTY.lidar(0.0)) is scan


@settings(max_examples=25, deadline=None)
@given(
    budget=st.integers(1, 300),
    distance=st.floats(3.0, 30.0),
    angle=st.floats(-9.0, 9.0),
    speed=st.floats(0.0, 20.0),
    occlusion=st.booleans(),
)
def test_a_budget_is_never_exceeded_and_each_beam_returns_once(
    budget: int, distance: float, angle: float, speed: float, occlusion: bool
) -> None:
    attack = point_phantoms.InjectedPoints(
        start_s=0.1, place=AHEAD, points=budget, distance_m=distance, angle_deg=angle, occlusion=occlusion
    )
    before, after = attacked(attack, Street(np.array([[9.0, 1.5, 0.0, 0.0]]), "VLP-16", speed=speed, wall_x=60.0), 3)
    new, replaced = moved(before, after)
    assert 0 < len(new) <= budget
    assert len(np.unique(after.keys())) == len(after)
    assert len(after) - len(new) == len(before) - len(replaced)
    assert (np.diff(after.time_s) >= 0.0).all()
    bearing = np.degrees(np.arctan2(new.position[:, 1], new.position[:, 0]))
    assert np.abs(bearing).max() < 10.0 + np.degrees(0.05 * speed / distance) + 1.0


@pytest.mark.parametrize("model", ["VLP-16", "OS1-128", "AT128"])
@pytest.mark.parametrize(("speed", "turn"), [(0.0, 0.0), (15.0, 0.3)])
def test_a_phantom_lies_on_the_beams_of_the_lidar_and_on_its_shape(model: str, speed: float, turn: float) -> None:
    attack = point_phantoms.InjectedPoints(
        start_s=0.1, place=AHEAD, points=4200, jitter_deg=0.0, noise_m=0.0, noise_per_deg_m=0.0
    )
    street = Street(np.zeros((0, 4)), model, speed=speed, turn=turn, wall_x=60.0, noise_m=0.0)
    before, after = attacked(attack, street, 4)
    new, replaced = moved(before, after)
    assert len(new) > 100
    assert len(replaced) == len(new), "a wall is behind it"
    cosine = np.einsum("ij,ij->i", new.position, replaced.position) / (new.range_m() * replaced.range_m())
    assert speed or np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 0.1
    low, high = new.position.min(axis=0), new.position.max(axis=0)
    assert abs(low[0] - 7.0) < 0.3
    assert (np.abs(high - low) < np.array(CAR) + 0.3).all()
    assert -HEIGHT_M < low[2] < -HEIGHT_M + 0.5


def test_with_occlusion_what_is_in_front_of_a_phantom_stays_and_nothing_in_its_shadow_does() -> None:
    street = Street(np.array([[8.0, 1.0, 0.0, 0.0]]), "OS1-128", wall_x=60.0)
    attack = point_phantoms.InjectedPoints(start_s=0.0, place=AHEAD, points=9999, distance_m=14.0, jitter_deg=0.0)
    before, after = attacked(attack, street)
    new, replaced = moved(before, after)
    assert (new.range_m() < replaced.range_m()).all()
    assert (replaced.range_m() > 13.0).all()
    body = np.array([[16.25, 0.0, -HEIGHT_M + 0.4]]), np.array([[3.0, 1.0, 0.2]])
    enter, leave = chords(after.position / after.range_m()[:, None], *body, np.zeros(1))
    assert not ((enter < leave) & (enter > 0.0) & (after.range_m()[:, None] > leave + 2.5)).any()
    careless = point_phantoms.InjectedPoints(start_s=0.0, place=AHEAD, points=9999, distance_m=14.0, occlusion=False)
    new, replaced = moved(*attacked(careless, street))
    assert (new.range_m() > replaced.range_m()).any()


def test_nothing_happens_without_sight_or_out_of_time_or_without_points() -> None:
    def removal(**more: Any) -> PointAttack:
        place = spoofers.Roadside(x=20.0, y=0.0, z=0.8, **SURE)
        return point_attacks.HighFrequencyRemoval(**{"place": place, "start_s": 0.0, **more})

    behind_a_car = Street(np.array([[10.0, 0.0, 0.0, 0.0]]), "VLP-16")
    before, after = attacked(removal(), behind_a_car)
    assert after is before
    assert attacked(removal(), EMPTY)[1] is not EMPTY
    for attack in (removal(start_s=1.0), removal(start_s=0.0, end_s=0.0), removal(success=0.0)):
        before, after = attacked(attack, EMPTY)
        assert after is before
    nowhere, few = EMPTY.points(), EMPTY.points().select(slice(0, 3))
    nowhere.position[5] = np.nan
    for scan in (Points.empty(), Points.of(EMPTY.points().position), nowhere, few, few.select(slice(0, 1))):
        assert removal().forge_points(0, 0, scan, EMPTY.lidar(0.0)) is scan


def test_an_attack_counts_why_it_left_scans_as_they_are() -> None:
    unaimed = spoofers.Following(aim_deg=10.0, lag_s=0.0)
    behind_a_car, car = (
        Street(np.array([[10.0, 0.0, 0.0, 0.0]]), "VLP-16"),
        spoofers.Roadside(x=20.0, y=0.0, z=0.8, **SURE),
    )
    for attack, street, reason in (
        (point_attacks.EarlyEcho(start_s=0.2, place=car, reach_m=50.0), behind_a_car, "no_sight"),
        (point_attacks.EarlyEcho(start_s=0.2, place=car), EMPTY, "out_of_reach"),
        (point_attacks.EarlyEcho(start_s=0.2, place=unaimed, success=0.0, reach_m=50.0), EMPTY, "missed"),
        (point_phantoms.Mirror(start_s=0.2, x=20.0, y=0.0, z=30.0), EMPTY, "same"),
    ):
        attacked(attack, street, frames=5)
        assert attack.counts() == {"scans": 3, reason: 3}
    first = point_attacks.EarlyEcho(start_s=0.0, place=spoofers.Following(distance_m=4.0))
    attacked(first, EMPTY)
    assert first.counts() == {"scans": 1, "first": 1}
    for points, reason in ((Points.empty(), "unusable"), (Points.of(EMPTY.points().position), "untimed")):
        attack = point_phantoms.Mirror(start_s=0.0)
        assert attack.forge_points(0, 0, points, EMPTY.lidar(0.0)) is points
        assert attack.counts() == {"scans": 1, reason: 1}


@pytest.mark.parametrize(
    ("model", "wall_x", "x", "y", "z", "sight"),
    [
        ("HDL-64E", 60.0, 20.0, 0.0, 1.5, True),
        ("VLP-16", None, 40.0, 0.0, 1.5, True),
        ("AT128", None, 20.0, 20.0, 1.5, True),
        ("AT128", None, 0.0, 20.0, 1.5, False),  # it looks 60 deg to each side
        ("HDL-64E", 15.0, 30.0, 0.0, 4.5, False),  # behind a wall, above the highest beam
        ("HDL-64E", 15.0, 40.0, 0.0, 12.0, False),
        ("VLP-16", 15.0, 40.0, 0.0, 14.0, False),
        ("VLP-16", 60.0, 3.0, 0.0, -3.0, False),  # below the ground
        ("VLP-16", 60.0, 8.0, 0.0, -0.45, False),
        ("VLP-32C", 60.0, 12.0, 0.0, -2.3, False),  # between two channels on the ground
    ],
)
def test_a_spoofer_has_sight_only_from_where_beams_look_and_nothing_hides_it(
    model: str, wall_x: float | None, x: float, y: float, z: float, sight: bool
) -> None:
    street, place = Street(np.zeros((0, 4)), model, wall_x=wall_x), spoofers.Roadside(x=x, y=y, z=z)
    assert place.in_sight(street.points(), np.array([x, y, z - HEIGHT_M])) is sight


def test_what_reaches_above_a_spoofer_hides_it_also_where_a_beam_returns_nothing() -> None:
    behind, place = np.array([30.0, 0.0, 2.0]), spoofers.Roadside(x=0.0, y=0.0)
    wall = Street(np.zeros((0, 4)), "VLP-16", wall_x=15.0).points()
    window = np.linalg.norm(wall.position[:, 1:] - (0.0, 1.0), axis=1) < 0.6
    assert not place.in_sight(wall.select(~window), behind)
    assert not place.in_sight(Points.empty(), behind)


def test_a_spoofer_turned_by_hand_misses_the_first_scan() -> None:
    def place(lag_s: float) -> PointAttack:
        return point_attacks.HighFrequencyRemoval(start_s=0.0, place=spoofers.Following(aim_deg=0.0, lag_s=lag_s))

    assert [share(place(lag_s), EMPTY, 2) for lag_s in (2.5, 0.0)] == [0.5, 1.0]


def test_the_same_seed_gives_the_same_scan_and_another_one_does_not() -> None:
    def scan(seed: int, name: str) -> Floats:
        attack = point_attacks.HighFrequencyRemoval(start_s=0.0, place=AHEAD)
        return attacked(attack, EMPTY, seed=seed, name=name)[1].position

    assert np.array_equal(scan(1, "a"), scan(1, "a"))
    assert not np.array_equal(scan(1, "a"), scan(2, "a"))
    assert not np.array_equal(scan(1, "a"), scan(1, "b"))


def test_success_falls_with_distance_and_with_speed() -> None:
    place = spoofers.Roadside(x=0.0, y=0.0)
    assert [place.aim(d, 0.0) for d in (5.0, 50.0, 200.0)] == pytest.approx([1.0, 0.92, 0.15], abs=0.02)
    by_speed = [place.aim(20.0, speed) for speed in (0.0, 0.01, 0.1, 1.0, 10.0)]
    assert by_speed == sorted(by_speed, reverse=True)
    standing = share(
        point_attacks.HighFrequencyRemoval(start_s=0.0, sector_deg=10.0, place=spoofers.Roadside(x=30.0, y=4.0)),
        EMPTY,
        60,
    )
    assert standing > 0.95
    passing = Street(np.zeros((0, 4)), "VLP-16", speed=60.0 / 3.6, wall_x=99.0)
    attack = point_attacks.HighFrequencyRemoval(start_s=0.2, sector_deg=10.0, place=spoofers.Roadside(x=40.0, y=4.0))
    assert share(attack, passing, 25) < 0.1


#: By lidar and asked width, deg: share of frames removed, median and 90th percentile of the gap, deg.
PUBLISHED = {
    ("AT128", 10.0): (1.0, 15, 15), ("AT128", 20.0): (1.0, 20, 24), ("AT128", 30.0): (0.79, 20, 24),
    ("AT128", 40.0): (0.414, 5, 18), ("AT128", 50.0): (0.821, 10, 17), ("AT128", 60.0): (0.568, 13, 20),
    ("XT32", 10.0): (1.0, 9, 10), ("XT32", 20.0): (1.0, 13, 14), ("XT32", 60.0): (0.889, 13, 14),
}  # fmt: skip


@pytest.mark.parametrize(("lidar", "asked"), PUBLISHED)
def test_widths_of_removal_are_those_of_the_published_check(lidar: Any, asked: float) -> None:
    attack = point_attacks.HighFrequencyRemoval(start_s=0.0, place=AHEAD, lidar=lidar, sector_deg=asked)
    attack.bind(1, "a")
    street = Street(np.zeros((0, 4)), "VLP-16", wall_x=30.0)
    scan, gaps = street.points(), []
    for frame in range(150):
        new, _ = moved(scan, attack.forge_points(frame, frame * 100_000_000, scan, street.lidar(0.0)))
        gaps.append(np.degrees(np.ptp(np.arctan2(new.position[:, 1], new.position[:, 0]))) if len(new) else 0.0)
    removed, median, p90 = PUBLISHED[lidar, asked]
    assert np.mean(np.array(gaps) > 0.0) == pytest.approx(removed, abs=0.12)
    assert np.quantile(gaps, 0.9) == pytest.approx(p90, abs=2.0)
    assert removed < 0.5 or np.median(gaps) == pytest.approx(median, abs=max(p90 - median, 2.0))


@pytest.mark.parametrize("frequency", [5.0, 15.0, 24.0])
def test_a_removed_sector_is_noise_nearer_than_the_distance_of_two_pulses(frequency: float) -> None:
    attack = point_attacks.HighFrequencyRemoval(start_s=0.0, place=AHEAD, frequency_mhz=frequency)
    new, _ = moved(*attacked(attack, EMPTY))
    assert 0.5 <= new.range_m().min() < new.range_m().max() <= 0.5 + 150.0 / frequency + 1e-3
    assert new.range_m().max() > 0.9 * 150.0 / frequency


def test_plain_pulses_hardly_ever_work_against_fingerprints() -> None:
    def plain(fingerprinting: bool) -> float:
        attack = point_attacks.HighFrequencyRemoval(
            start_s=0.0, place=AHEAD, adaptive=False, fingerprinting=fingerprinting, sector_deg=10.0
        )
        return share(attack, EMPTY, 100)

    assert plain(True) < 0.05
    assert plain(False) == 1.0


def test_early_echoes_and_saturation_remove_what_they_cover_and_nothing_else() -> None:
    near, far = (spoofers.Following(distance_m=metres, **SURE) for metres in (4.0, 10.0))
    before, after = attacked(point_attacks.EarlyEcho(start_s=0.0, place=near), EMPTY)
    bearing = np.degrees(np.arctan2(after.position[:, 1], after.position[:, 0]))
    assert np.abs(bearing).min() == pytest.approx(15.0, abs=0.3)
    assert set(after.keys()) < set(before.keys())
    before, after = attacked(point_attacks.EarlyEcho(start_s=0.0, place=far), EMPTY)
    assert after is before
    before, after = attacked(point_attacks.Saturation(start_s=0.0, place=far), EMPTY)
    new, _ = moved(before, after)
    assert len(after) < len(before)
    assert (np.degrees(np.abs(np.arctan2(new.position[:, 1], new.position[:, 0]))) <= 10.1).all()


def test_scans_are_replayed_and_delayed_as_a_whole() -> None:
    street = Street(np.array([[12.0, 0.0, 0.0, 5.0]]), "VLP-16")
    scans = [street.points(0.1 * frame, frame) for frame in range(6)]
    late, again = point_attacks.DelayedScan(start_s=0.0, scans=2), point_attacks.RelayedScan(start_s=0.3, length_s=0.2)
    got: list[list[Points]] = []
    for attack in (late, again):
        attack.bind(1, "a")
        got.append([attack.forge_points(k, k * 100_000_000, scan, street.lidar(0.0)) for k, scan in enumerate(scans)])
    assert [scans.index(scan) for scan in got[0]] == [0, 0, 0, 1, 2, 3]
    assert [scans.index(scan) for scan in got[1]] == [0, 1, 2, 0, 1, 0]


@pytest.mark.parametrize("position", [np.zeros((0, 3)), np.full((4, 3), np.nan)])
def test_a_scan_that_no_beam_could_be_changed_in_is_replaced_all_the_same(position: Floats) -> None:
    full, odd = EMPTY.points(), Points.of(position)
    late, again = point_attacks.DelayedScan(start_s=0.0), point_attacks.RelayedScan(start_s=0.1)
    for attack in (late, again):
        attack.bind(1, "a")
        got = [attack.forge_points(k, k * 100_000_000, scan, EMPTY.lidar(0.0)) for k, scan in enumerate((full, odd))]
        assert got == [full, full]


def test_a_mirror_hides_what_is_behind_it_and_shows_what_is_beside_the_road() -> None:
    street = Street(np.array([[14.0, 8.0, 0.0, 0.0], [22.0, 0.0, 0.0, 0.0]]), "OS1-128")
    mirror = point_phantoms.Mirror(start_s=0.0, x=14.0, y=0.0, yaw_deg=135.0, width_m=1.5)
    before, after = attacked(mirror, street)
    new, replaced = moved(before, after)
    assert len(after) < len(before)
    assert len(np.unique(after.keys())) == len(after)
    gone = ~np.isin(before.keys(), after.keys())
    assert (before.position[gone, 0] > 13.0).all()
    assert (replaced.position[:, 0] > 13.0).all()
    car = new.position[new.position[:, 2] > -1.5]
    assert len(car) > 20
    assert np.allclose(car.mean(axis=0)[:2], (21.5, 0.0), atol=1.5), "its side is mirrored into the road, 8 m behind"


def test_a_forged_mesh_is_denser_than_any_lidar_and_removes_a_car() -> None:
    car = Street(np.array([[25.0, 0.0, 0.0, 0.0]]), "VLP-16", wall_x=60.0)
    before, after = attacked(point_phantoms.ForgedMesh(start_s=0.0, distance_m=25.0), EMPTY)
    assert len(moved(before, after)[0]) > 10 * np.count_nonzero(np.abs(car.points().position[:, 0] - 25.0) < 3.0)
    assert len(np.unique(after.keys())) < len(after), "points share beams"
    before, after = attacked(point_phantoms.ForgedMesh(start_s=0.0, distance_m=25.0, remove=True), car)

    def on_car(points: Points) -> int:
        x, y, z = points.position.T
        return int(np.count_nonzero((np.abs(x - 25.0) < 2.27) & (np.abs(y) < 0.92) & (z > -1.7)))

    assert on_car(before) > 10
    assert on_car(after) == 0


def test_a_spoofer_on_a_car_moves_with_the_route_of_its_agent() -> None:
    sensor = {
        "limits_deg": [-180, 180, -90, 90], "max_range_m": 70, "mount_position": [0, 0, 1.8],
        "mount_rotation": np.eye(3).tolist(), "route": [[0, 10, 0, 0, 1, 0, 0, 0], [10, 110, 0, 0, 1, 0, 0, 0]],
    }  # fmt: skip
    surroundings, lidar = Surroundings(agents={"infra_1": sensor}), EMPTY.lidar(0.0)
    place = spoofers.OnCar(agent="infra_1")
    assert place.position(5.0, lidar, surroundings).tolist() == [60.0, 0.0, 1.5]
    with pytest.raises(ValueError, match=r"agent: found 'x'.*infra_1"):
        spoofers.OnCar(agent="x").position(0.0, lidar, surroundings)
    turned = EMPTY.lidar(0.0)[0], np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert spoofers.Following(distance_m=-8.0, height_m=0.0).position(0.0, turned, surroundings) == pytest.approx(
        [0.0, -8.0, HEIGHT_M]
    )


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("start_s", lambda: point_attacks.DelayedScan(start_s=-1.0)),
        ("success", lambda: point_attacks.EarlyEcho(success=1.5)),
        ("points", lambda: point_phantoms.InjectedPoints(points=0)),
        ("frequency_mhz", lambda: point_attacks.HighFrequencyRemoval(frequency_mhz=0.0)),
        ("spot_m", lambda: spoofers.Following(spot_m=0.0)),
    ],
)
def test_an_impossible_number_is_refused_with_its_name(name: str, make: Any) -> None:
    with pytest.raises(ValueError, match=f"{name}: found"):
        make()


def test_a_phantom_on_the_wire_of_one_lidar_becomes_a_detection_of_that_agent_alone() -> None:
    def detections(attack: dict[str, Any] | None) -> dict[str, list[int]]:
        def edit(content: dict[str, Any]) -> None:
            content["points"] = dict(detector=dict(type="ClusterDetector"), lidar="VLP-16", clutter=None)
            if attack:
                content["adversaries"] = dict(spoofer_1=dict(type="Adversary", agent="ego", attack=attack))
                content["keyexpr"] = dict(map="testbed.toml", rewrites=["on_points.toml"])

        run = Run(tiny(frames=5, edit=edit))
        assert not run.failures
        return {
            agent: [len(message.body["yaw"]) for message in run.decoded(f"agent/{agent}/detections", "detections")]
            for agent in ("ego", "infra_1")
        }

    quiet = detections(None)
    spoofed = detections(dict(type="CaoInjection", start_s=0.2, place=dict(type="Following", **SURE)))
    assert [a - b for a, b in zip(spoofed["ego"], quiet["ego"], strict=True)] == [0, 0, 1, 1, 1]
    assert spoofed["infra_1"] == quiet["infra_1"]
