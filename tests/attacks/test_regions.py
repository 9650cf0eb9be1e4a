"""False objects appear in plausible places: in view, unobstructed, on the path; routes and commands have times."""

import numpy as np
import pytest
from attack_worlds import at
from hypothesis import example, given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.attacks import Surroundings, UncoordinatedSelection
from mast_zenoh.attacks.attack import SeizedCommands
from mast_zenoh.attacks.campaign import TrajectoryPropagation
from mast_zenoh.attacks.coordination import Coordinator
from mast_zenoh.attacks.regions import path_ahead
from mast_zenoh.attacks.selection import ConflictSelection
from mast_zenoh.attacks.surroundings import Coverage, Route, touching
from mast_zenoh.streams import stream

LEVEL = np.eye(3).ravel().tolist()
#: Blocks on both sides of a street along x, 12 m wide.
BLOCKS = [
    [[x, y], [x + 20.0, y], [x + 20.0, y + 20.0], [x, y + 20.0]]
    for x in (-60.0, -30.0, 10.0, 40.0)
    for y in (6.0, -26.0)
]
LOOKS_EAST = dict(limits_deg=[-45.0, 45.0, -60.0, 30.0], max_range_m=80.0, mount_rotation=LEVEL)
ALL_ROUND = dict(limits_deg=[-180.0, 180.0, -60.0, 30.0], max_range_m=80.0, mount_rotation=LEVEL)


def pose(x: float, y: float, time_s: float = 0.0, half_turn: bool = False) -> list[float]:
    return [time_s, x, y, 0.0, *((0.0, 0.0, 0.0, 1.0) if half_turn else (1.0, 0.0, 0.0, 0.0))]


#: The ego drives east at 10 m/s; one pole looks east from the west end, another west from x = 40.
AGENTS = {
    "ego": ALL_ROUND
    | dict(mount_position=[0.0, 0.0, 1.8], route=[pose(-40.0 + 10.0 * t, 0.0, float(t)) for t in range(9)]),
    "infra_1": LOOKS_EAST | dict(mount_position=[0.0, 0.0, 8.0], route=[pose(-70.0, 0.0)]),
    "infra_2": LOOKS_EAST | dict(mount_position=[0.0, 0.0, 8.0], route=[pose(40.0, 0.0, half_turn=True)]),
}
KNOWN = Surroundings(agents=AGENTS, victims=("infra_1",), buildings=BLOCKS, building_height=[12.0] * len(BLOCKS))
TRAFFIC = at((-30.0, -2.0), (-10.0, 2.0), (15.0, -2.0), id=np.full(3, -1))


def coverage(victim: str = "infra_1", time_s: float = 0.0, surroundings: Surroundings = KNOWN) -> Coverage:
    sensor = surroundings.sensors[victim]
    return Coverage(surroundings, (sensor.view(*sensor.route.at(time_s)),), time_s)


def false_objects(region: str, seed: int, where: Coverage, n: float = 6.0) -> ObjectStates:
    selection = UncoordinatedSelection(n_false_positives=n, region=region)
    return selection.select(TRAFFIC, where, stream(seed)).add


@given(
    st.sampled_from(["in_view", "ego_path", "victim_only", "few_witnesses", "many_witnesses", "unseen_by_ego"]),
    st.integers(0, 10_000),
)
def test_false_objects_are_in_view_and_never_in_a_building_or_another_object(region, seed):
    where = coverage()
    false = false_objects(region, seed, where)
    assert where.visible_outside_objects(false, TRAFFIC, where.victims[0]).all()
    assert not KNOWN.inside_buildings(false.position).any()
    assert not touching(false, TRAFFIC).any()
    for k in range(len(false)):
        assert not touching(false.select(slice(k, k + 1)), false.select(np.arange(len(false)) != k)).any()


@given(st.sampled_from(["in_view", "victim_only"]), st.integers(0, 10_000))
@example("victim_only", 2046)  # placed less than a millimetre in front of a wall
def test_paths_of_false_objects_end_before_buildings(region, seed):
    false, model = false_objects(region, seed, coverage()), TrajectoryPropagation()
    for k in range(200):
        false = model.advance(false, 0.1, k * 0.1, stream(0))
    assert np.all(false.velocity == 0.0)
    assert not KNOWN.inside_buildings(false.position).any()


def test_the_distribution_of_the_paper_ignores_views_and_buildings():
    false = concatenate([false_objects("paper", seed, coverage()) for seed in range(60)])
    where = coverage()
    assert where.visible_outside_objects(false, ObjectStates.empty(), where.victims[0]).mean() < 0.5
    assert KNOWN.inside_buildings(false.position).any()


def test_false_objects_on_the_egos_path_are_ahead_in_its_lane_and_slower():
    where = coverage(time_s=2.0)  # the ego is at x = -20
    false = concatenate([false_objects("ego_path", seed, where) for seed in range(20)])
    assert len(false) > 20
    ahead = false.position[:, 0] + 20.0
    assert np.all((ahead >= 10.0) & (ahead <= 60.0))
    assert np.all(np.abs(false.position[:, 1]) <= 1.75)
    assert np.all(np.hypot(*false.velocity[:, :2].T) <= 0.5 * 10.0 + 1e-9)
    assert np.allclose(false.yaw, 0.0)


def test_victim_only_objects_are_outside_all_other_known_views():
    where = coverage(time_s=8.0)  # the ego is at x = 40
    false = concatenate([false_objects("victim_only", seed, where) for seed in range(40)])
    boxes = np.concatenate([false.position, false.size], axis=1)
    for view in where.other_views():
        assert not where.visible(view, boxes).any()


def test_few_and_many_witnesses_divide_what_the_victim_sees():
    where = coverage(time_s=4.0)  # the ego is at x = 0, and infra_2 looks at the street in front of it
    viewers = {
        region: where.honest_viewers(concatenate([false_objects(region, seed, where) for seed in range(40)]))
        for region in ("few_witnesses", "many_witnesses")
    }
    assert set(viewers["few_witnesses"].tolist()) == {0, 1}
    assert set(viewers["many_witnesses"].tolist()) == {2}


def test_objects_unseen_by_the_ego_are_in_its_blind_area_though_others_look():
    short = Surroundings(
        agents=AGENTS | {"ego": AGENTS["ego"] | dict(max_range_m=30.0)},
        victims=("infra_1",),
        buildings=BLOCKS,
        building_height=[12.0] * len(BLOCKS),
    )
    ego, where = short.sensors["ego"], coverage(time_s=4.0, surroundings=short)
    false = concatenate([false_objects("unseen_by_ego", seed, where) for seed in range(40)])
    boxes = np.concatenate([false.position, false.size], axis=1)
    assert len(false) > 20
    assert not where.visible(ego.view(*ego.route.at(4.0)), boxes).any()
    assert where.honest_viewers(false).any(), "by infra_2"


def test_an_object_without_a_permitted_position_is_omitted():
    walled_in = Surroundings(
        agents={"infra_1": LOOKS_EAST | dict(mount_position=[0.0, 0.0, 2.0], route=[pose(0.0, 0.0)])},
        victims=("infra_1",),
        buildings=[[[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]],
        building_height=[20.0],
    )
    assert len(false_objects("in_view", 1, coverage(surroundings=walled_in), 30.0)) == 0


def test_beyond_its_route_the_ego_path_continues_straight():
    path = path_ahead(coverage(time_s=8.0))
    assert path is not None
    place, yaw = path.at(np.array([30.0]))
    assert place.tolist() == [[70.0, 0.0]]
    assert yaw.tolist() == [0.0]


def test_walls_occlude_only_lower_objects_behind_them():
    eye = np.array([20.0, -4.0, 2.0])
    places = np.array([[20.0, 40.0, 1.0], [20.0, 40.0, 60.0], [20.0, 4.0, 1.0]])
    assert KNOWN.behind_walls(eye, places).tolist() == [True, False, False]


def moving(*states: tuple[float, float, float, float]) -> ObjectStates:
    table = np.array(states)
    return at(*map(tuple, table[:, :2])).with_(velocity=np.column_stack([table[:, 2:], np.zeros(len(table))]))


def chosen(selection: ConflictSelection, objects: ObjectStates) -> list[list[float]]:
    return selection.select(objects, coverage("ego"), stream(0)).remove.position[:, :2].tolist()


def test_the_object_with_the_closest_approach_is_hidden_and_never_the_ego():
    objects = moving((-40.0, 0.5, 10.0, 0.0), (0.0, 3.0, 0.0, 0.0), (-30.0, -5.0, -10.0, 0.0))
    assert chosen(ConflictSelection(unseen_by_ego=False), objects) == [[0.0, 3.0]]


def test_an_object_behind_a_corner_is_hidden_before_one_visible_to_the_ego():
    objects = moving((0.0, 3.0, 0.0, 0.0), (0.0, 40.0, 0.0, -4.0))
    assert chosen(ConflictSelection(), objects) == [[0.0, 40.0]]


def test_an_object_in_the_egos_own_tracks_is_hidden_only_if_there_is_no_other():
    objects = at((0.0, 3.0), (10.0, 6.0), id=np.full(2, -1))
    tracks = at((0.5, 3.2), id=np.zeros(1, np.int64))
    view = Coverage(KNOWN, (), 0.0, ego_tracks=tracks)
    nearest, other = objects.position[0], objects.position[1]
    assert np.array_equal(ConflictSelection().select(objects, view, stream(1)).remove.position, [other])
    known = objects.select(np.array([0]))
    assert np.array_equal(ConflictSelection().select(known, view, stream(1)).remove.position, [nearest])


def test_only_objects_near_the_configured_position_are_hidden():
    objects = at((0.0, 3.0), (30.0, 2.0), id=np.full(2, -1))
    assert chosen(ConflictSelection(near=(900.0, 900.0)), objects) == []
    assert chosen(ConflictSelection(near=(49.0, 2.0)), objects) == [[30.0, 2.0]]


def test_an_attack_that_begins_before_any_track_exists_hides_the_first_possible_object():
    coordinator = Coordinator(selection=ConflictSelection(), reselect_every_s=None, start_s=0.5)
    coordinator.inform(KNOWN)
    coordinator.bind(1, "coordinator")
    position = KNOWN.sensors["infra_1"].route.position
    hidden = []
    for frame in range(30):
        seen = at((0.0, 3.0), id=np.zeros(1, np.int64)) if frame >= 10 else ObjectStates.empty()
        source = np.zeros(len(seen), np.int64)
        (targets,) = coordinator.step(frame, frame * 100_000_000, seen, source, position)
        hidden.append(targets.remove.id.tolist())
    first = hidden.index([0])
    assert first >= 10
    assert hidden == [[]] * first + [[0]] * (30 - first), "one target, selected once"


@pytest.mark.parametrize(("time_s", "acceleration"), [(0.9, 1.0), (1.0, -6.0), (2.9, -6.0), (3.0, 1.0)])
def test_the_acceleration_is_replaced_from_the_start_to_the_end_and_the_curvature_never(time_s, acceleration):
    attack = SeizedCommands(acceleration=-6.0, start_s=1.0, end_s=3.0)
    assert attack.forge_command(round(time_s * 1e9), 1.0, 0.02) == (acceleration, 0.02)


def test_the_time_of_a_route_is_when_it_is_nearest() -> None:
    """It stands for 2 s, then drives 10 m/s to the east."""
    route = Route.of_rows([[0.0, 0, 0, 0, 1, 0, 0, 0], [2.0, 0, 0, 0, 1, 0, 0, 0], [4.0, 20, 0, 0, 1, 0, 0, 0]])
    assert route.time_near(np.array([-3.0, 0.0])) == 0.0
    assert route.time_near(np.array([7.0, 2.0])) == pytest.approx(2.7)
    assert route.time_near(np.array([99.0, 0.0])) == pytest.approx(4.0)
