"""Information matrix fusion takes from each track what is new: it equals a central filter and counts nothing twice."""

import numpy as np
import pytest
from tracked_objects import MATURE, STEP_S, assert_same_bits, cars, centre, nanoseconds

from mast_zenoh.arrays.chi_square import mean_bounds
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints, ObjectStates, concatenate
from mast_zenoh.fusion import (
    CovarianceIntersectionFusion,
    GroupTracker,
    GroupTrackerWrapper,
    InformationMatrixGroupTracker,
    NaiveKalmanFusion,
    information_matrix,
)
from mast_zenoh.fusion.information_matrix import ContributedTracks
from mast_zenoh.tracking import InteractingModelsTracker3D, KalmanBoxTracker3D, classes, kalman, tracks

CI = CovarianceIntersectionFusion
NOISE = np.array([0.16, 0.16, 0.04, 0.09, 0.09, 0.09])
PRIOR = np.array([0.16, 0.16, 0.04, 0.09, 0.09, 0.09, 4.0, 4.0, 0.1])
CAR = CLASS_INDEX["car"]
Q = kalman.process_noise(STEP_S, classes.ACCELERATION, classes.VERTICAL_ACCELERATION, classes.SIZE_DRIFT)


def information(**parameters: float) -> InformationMatrixGroupTracker:
    return InformationMatrixGroupTracker(fusion=CI(), tracker=KalmanBoxTracker3D(), **parameters)


def intersection() -> GroupTracker:
    return GroupTrackerWrapper(fusion=CI(), tracker=KalmanBoxTracker3D())


def adapted_kalman() -> GroupTracker:
    return GroupTrackerWrapper(fusion=NaiveKalmanFusion(), tracker=KalmanBoxTracker3D(independent_states=True))


class World:
    """Objects that move as the model says, a filter for each agent, and a central one that has all measurements."""

    def __init__(self, agents: int, objects: int, seed: int = 0) -> None:
        self.random = np.random.default_rng(seed)
        self.truth = np.tile([0.0, 0.0, 0.8, 4.5, 1.8, 1.5, 8.0, 0.0, 0.0], (objects, 1))
        self.truth[:, 1] = 400.0 * np.arange(objects)
        self.tables = []
        for _ in range(agents):
            table = tracks.empty(objects)
            table[:, tracks.MEAN] = self.truth + self.random.normal(0.0, np.sqrt(PRIOR), self.truth.shape)
            table[:, tracks.COVARIANCE] = np.diag(PRIOR).ravel()
            self.tables.append(table)
        self.central = self.tables[0].copy()
        for table in (*self.tables, self.central):
            table[:, tracks.CLASS] = CAR

    def step(self) -> tuple[ObjectStates, Ints, Ints]:
        """The tracks of all agents in the next frame, whose they are, and of which object."""
        n = len(self.truth)
        self.truth[:, :3] += STEP_S * self.truth[:, 6:]
        self.truth += self.random.multivariate_normal(np.zeros(9), Q[CAR], n)
        noise = np.tile(np.diag(NOISE), (n, 1, 1))
        for table in (*self.tables, self.central):
            kalman.predict(table, STEP_S, Q)
        for table in self.tables:
            measured = self.truth[:, :6] + self.random.normal(0.0, np.sqrt(NOISE), (n, 6))
            kalman.correct(table, measured, noise)
            kalman.correct(self.central, measured, noise)
        count = len(self.tables)
        states = concatenate([self.states_of(table) for table in self.tables])
        return states, np.repeat(np.arange(count), n), np.tile(np.arange(n), count)

    def states_of(self, table: Floats) -> ObjectStates:
        x = table[:, tracks.MEAN]
        columns = dict(id=np.arange(len(x)), size=x[:, 3:6].copy(), covariance=tracks.covariances(table).copy())
        return cars(x[:, :3].copy(), x[:, 6:8].copy(), **columns).with_(velocity=x[:, 6:9].copy())


def played(group: GroupTracker, world: World, frames: int = 50) -> ObjectStates:
    for frame in range(frames):
        picture, _ = group.step(nanoseconds(frame), *world.step())
    return picture.select(np.argsort(group.clusters))


def mean_nees(picture: ObjectStates, world: World) -> float:
    """Of the horizontal motion."""
    assert len(picture) == len(world.truth)
    rows = np.array([0, 1, 6, 7])
    error = np.column_stack([picture.position[:, :2], picture.velocity[:, :2]]) - world.truth[:, rows]
    covariance = picture.covariance[:, rows[:, None], rows]
    return float(np.vecdot(error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]).mean())


def test_the_picture_equals_that_of_a_central_filter_with_all_measurements() -> None:
    world = World(agents=3, objects=12)
    picture, central = played(information(), world, frames=150), world.states_of(world.central)
    np.testing.assert_allclose(picture.position[:, :2], central.position[:, :2], atol=1e-5)
    np.testing.assert_allclose(picture.velocity, central.velocity, atol=1e-5)
    moving = np.ix_([0, 1, 6, 7], [0, 1, 6, 7])
    for found, expected in zip(picture.covariance, central.covariance, strict=True):
        np.testing.assert_allclose(found[moving], expected[moving], atol=1e-5)


def test_information_matrix_fusion_is_consistent_where_a_kalman_filter_of_tracks_is_too_certain() -> None:
    objects = 400
    low, high = mean_bounds(objects, 4)
    assert low <= mean_nees(played(information(), world := World(4, objects)), world) <= high
    assert mean_nees(played(intersection(), world := World(4, objects)), world) < low
    assert mean_nees(played(adapted_kalman(), world := World(4, objects)), world) > 2.0 * high


def test_a_track_that_only_coasts_adds_nothing() -> None:
    """What is not measured becomes as uncertain as in the agent's own tracker."""
    group, track = information(), cars([[0.0, 0.0]], (8.0, 0.0))
    agent = labels = np.zeros(1, np.int64)
    for frame in range(8):
        picture, _ = group.step(nanoseconds(frame), track, agent, labels)
        np.testing.assert_allclose(picture.covariance, track.covariance[: len(picture)], rtol=1e-6, atol=1e-9)
        track = kalman.predicted(track, STEP_S)
    assert len(picture) == 1


def test_an_agent_that_is_silent_for_a_moment_is_not_counted_twice() -> None:
    """Its track is subtracted as it was fused last, predicted: the picture is nearly that of a central filter again.

    Not exactly, as the process noise since then is in the tracks of both agents.
    """
    group, world = information(), World(agents=2, objects=6)
    for frame in range(150):
        states, agent, labels = world.step()
        heard = (agent == 0) | (frame % 7 < 3)
        picture, _ = group.step(nanoseconds(frame), states.select(heard), agent[heard], labels[heard])
    central = world.states_of(world.central)
    np.testing.assert_allclose(picture.covariance[:, 0, 0], central.covariance[:, 0, 0], rtol=0.01)


@pytest.mark.parametrize("trusted", [True, False])
def test_agents_are_told_apart_by_name_when_others_come_and_go(trusted: bool) -> None:
    """A picture without an agent's tracks is the same, whether it is in the list of names or not."""
    pictures = []
    for leaves in (True, False):
        group, world = information(), World(agents=3, objects=4)
        for frame in range(40):
            states, agent, labels = world.step()
            gone, names = frame >= 20, ("a", "b", "c")
            weights = np.where((agent == 1) & gone, 0.0, 1.0)
            if gone and leaves:
                names, kept = ("a", "c"), agent != 1
                states, agent, labels, weights = states.select(kept), agent[kept] // 2, labels[kept], weights[kept]
            group.name_agents(names)
            picture, _ = group.step(nanoseconds(frame), states, agent, labels, weights if trusted else None)
        pictures.append(picture)
    if trusted:
        assert_same_bits(*pictures)
    else:
        assert not np.array_equal(pictures[0].covariance, pictures[1].covariance)  # in the other run, b was fused


def test_a_pipeline_names_the_agents_to_its_group_tracker() -> None:
    """An agent that is not in the list of names has the same effect as one that is, and sends nothing."""
    pictures = []
    for listed in (True, False):
        pipeline, world = centre(information()), World(agents=3, objects=4)
        for frame in range(40):
            states, agent, _ = world.step()
            silent = frame >= 20
            kept = (agent != 1) | (not silent)
            states, agent, names = states.select(kept), agent[kept], ("a", "b", "c")
            if silent and not listed:
                agent, names = agent // 2, ("a", "c")
            picture, _ = pipeline.step(nanoseconds(frame), states, agent, names)
        pictures.append(picture)
    assert_same_bits(*pictures)


def test_a_track_that_becomes_very_uncertain_leaves_the_fused_state() -> None:
    """All information of the object would be withdrawn; it is what the fusion makes of its tracks instead."""
    group, agent = information(), np.zeros(1, np.int64)
    for frame in range(10):
        certain = cars([[0.0, 0.0]], covariance=0.01 * MATURE)
        group.step(nanoseconds(frame), certain, agent, agent)
    doubtful = cars([[0.5, 0.0]], covariance=4.0 * MATURE)
    picture, _ = group.step(nanoseconds(10), doubtful, agent, agent)
    np.testing.assert_allclose(picture.position[0], doubtful.position[0], atol=1e-9)
    np.testing.assert_allclose(picture.covariance[0], doubtful.covariance[0], atol=1e-9)


def test_a_flood_of_tracks_with_new_ids_is_not_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(information_matrix, "_MOST_UNFUSED", 50)
    contributed = ContributedTracks()
    for frame in range(20):
        contributed.predict(nanoseconds(frame))
        flood = cars(np.zeros((40, 2)), id=np.arange(40) + 40 * frame)
        contributed.add(flood, np.zeros(40, np.int64), np.arange(40))
    assert len(contributed.states) == 90
    assert set(range(760, 800)) <= set(contributed.states.id.tolist())
    contributed.predict(nanoseconds(100))
    contributed.add(ObjectStates.empty(), np.zeros(0, np.int64), np.zeros(0, np.int64))
    assert len(contributed.states) == 0


def test_a_tracker_with_several_motion_models_is_refused() -> None:
    with pytest.raises(ValueError, match=r"tracker.*InteractingModelsTracker3D.*KalmanBoxTracker3D"):
        InformationMatrixGroupTracker(fusion=CI(), tracker=InteractingModelsTracker3D())
