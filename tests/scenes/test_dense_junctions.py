"""The dense generated junction: close followers, parked cars and queues as in recorded traffic, and no contacts."""

import hashlib
from functools import cache

import numpy as np
import pytest

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.driving.motion import Command
from mast_zenoh.scenes import Intersection
from mast_zenoh.scenes.generated.driven import DrivenTraffic
from mast_zenoh.scenes.generated.intersection import _junction
from mast_zenoh.scenes.generated.junction import ROAD
from mast_zenoh.scenes.generated.traffic import Movers
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import CleanDetector

pytestmark = pytest.mark.heavy

JUNCTIONS = range(10)
VEHICLES = [CLASSES.index(name) for name in ("car", "truck", "bus")]


@cache
def dense(scene_index: int) -> Recording:
    return Intersection(scene_index=scene_index, n_infrastructure=0, detector=CleanDetector(), dense=True).record(
        scene_index, None
    )


def columns(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Position (F, n, 2), speed (F, n), yaw (F, n) of all objects, and the rows (k,) of the vehicles."""
    frames, n = len(recording), len(recording.truth_at(0))
    truth = recording.truth
    vehicles = np.flatnonzero(np.isin(truth.class_id[:n], VEHICLES))
    speed = np.linalg.norm(truth.velocity, axis=1).reshape(frames, n)
    return truth.position.reshape(frames, n, 3)[..., :2], speed, truth.yaw.reshape(frames, n), vehicles


def time_gaps(recording: Recording) -> np.ndarray:
    """(k,) s, of vehicles at 2 m/s and more to the one ahead in their lane, if that is nearer than 100 m.

    Counted as in the clips of NGSIM: ahead is what is less than 1.5 m beside the heading, and points the same way.
    """
    position, speed, yaw, vehicles = columns(recording)
    length, gaps = recording.truth.size[vehicles, 0], []
    for frame in range(0, len(recording), 5):
        at, turn = position[frame, vehicles], yaw[frame, vehicles]
        offset = at[None] - at[:, None]
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        along, across = c * offset[..., 0] + s * offset[..., 1], c * offset[..., 1] - s * offset[..., 0]
        same = (np.abs(across) < 1.5) & (np.abs(wrap_angle(turn[None] - turn[:, None])) < 0.4) & (along > 0.0)
        gap = np.where(same, along - (length[:, None] + length[None]) / 2, np.inf).min(axis=1)
        moving = (speed[frame, vehicles] > 2.0) & (gap < 100.0)
        gaps.append(gap[moving] / speed[frame, vehicles][moving])
    return np.concatenate(gaps)


def test_sparse_traffic_is_that_of_earlier_versions() -> None:
    recording = Intersection(scene_index=1, n_infrastructure=1, dense=False).record(3, 20)
    digest = hashlib.sha256()
    for column in (recording.truth.position, recording.truth.velocity, recording.truth.size):
        digest.update(np.round(column * 1e4).astype(np.int64).tobytes())
    assert digest.hexdigest() == "fdc3490679fff13813e8d601180647bc0a7be92d5c8a9b300e3d6f6083d1802b"


def test_time_gaps_are_those_of_recorded_traffic() -> None:
    gaps = np.concatenate([time_gaps(dense(scene_index)) for scene_index in JUNCTIONS])
    assert 0.1 <= (gaps < 1.0).mean() <= 0.22
    assert 0.5 <= np.percentile(gaps, 5) <= 0.85
    assert 1.4 <= np.median(gaps) <= 2.2


def test_vehicles_near_the_ego_and_the_share_that_stands_are_those_of_recorded_traffic() -> None:
    near, standing = [], []
    for scene_index in JUNCTIONS:
        position, speed, _, vehicles = columns(dense(scene_index))
        ego = position[:, dense(scene_index).agents[0].object_id]
        close = np.hypot(*np.moveaxis(position[:, vehicles] - ego[:, None], -1, 0)) < 100.0
        near.append(close.sum(axis=1).mean())
        standing.append((close & (speed[:, vehicles] < 0.5)).sum() / close.sum())
    assert 26 <= np.mean(near) <= 58
    assert min(near) > 20
    assert max(near) < 58
    assert 0.53 <= np.mean(standing) <= 0.69


def test_parked_cars_stand_beside_the_lanes_and_are_no_agents() -> None:
    few = Intersection(scene_index=1, n_infrastructure=0, n_vehicles=10, dense=True).record(0, 2)
    _, speed, _, vehicles = columns(few)
    assert len(vehicles) >= 36
    assert (speed[:, vehicles] == 0.0).all(axis=0).sum() >= 26
    crowded = Intersection(scene_index=0, n_infrastructure=0, n_mobile=15, dense=True).record(0, 2)
    assert len(crowded.agents) == 16
    assert max(agent.object_id for agent in crowded.agents) < 26


@pytest.mark.parametrize(
    ("headway", "reaction", "braking", "contact"),
    [(0.3, 1.0, 7.0, True), (0.3, 1.0, 2.0, False), (1.5, 1.0, 7.0, False), (0.3, 0.0, 2.5, False)],
)
def test_only_a_close_follower_that_reacts_late_hits_a_car_that_brakes_as_hard_as_it_can(
    headway: float, reaction: float, braking: float, contact: bool
) -> None:
    network = _junction(0).network
    lane = next(row for row, lane in enumerate(network.lanes) if lane.user == ROAD and not lane.connector)
    two = np.ones(2)
    movers = Movers(
        size=np.tile([4.5, 1.8, 1.5], (2, 1)),
        user=np.full(2, ROAD),
        speed=np.array([10.0, 12.0]),
        acceleration=1.6 * two,
        braking=2.0 * two,
        headway=headway * two,
        gap=2.0 * two,
        path=np.full(2, lane),
        start=np.array([15.0, 5.0]),
        reaction=reaction * two,
        guide=np.zeros(2, np.int64),
        exact_headway=True,
    )
    traffic = DrivenTraffic(network, movers, 0, "two")
    traffic.release()
    nearest = np.inf
    for step in range(150):
        traffic.commands = {0: Command(-braking, 0.0)} if step >= 100 else {}
        traffic.step(0.1)
        nearest = min(nearest, float(traffic.s[0] - traffic.s[1]) - 4.5)
    assert traffic.v[0] == 0.0
    assert traffic.route[0, 0] == lane
    assert (nearest < 0.0) == contact
