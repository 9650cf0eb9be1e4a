"""Tracks and pictures of the reference scene."""

import numpy as np
import pytest
from reference_scene import Frames, read, run, score, unpacked
from tracked_objects import assert_same_bits

from mast_zenoh.arrays.states import ObjectStates, concatenate
from mast_zenoh.fusion import (
    BestMemberFusion,
    Clusterer,
    CovarianceCheck,
    CovarianceIntersectionFusion,
    DBSCANClusterer,
    Fusion,
    GroupTrackerWrapper,
    ReportedCovariances,
    SampledAssignmentClusterer,
    UnfilteredGroupTracker,
)
from mast_zenoh.fusion.pipelines import CommandCenterPipeline
from mast_zenoh.tracking import KalmanBoxTracker3D


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Frames:
    return read(unpacked(tmp_path_factory.mktemp("scene_a")))


def pipeline(
    clustering: Clusterer | None = None, fusion: Fusion | None = None, covariances: CovarianceCheck | None = None
) -> CommandCenterPipeline:
    tracking = GroupTrackerWrapper(fusion=fusion or CovarianceIntersectionFusion(), tracker=KalmanBoxTracker3D())
    return CommandCenterPipeline(
        clustering=clustering or SampledAssignmentClusterer(assign_radius=2.0),
        group_tracking=tracking,
        covariances=covariances,
    )


@pytest.fixture(scope="module")
def result(scene: Frames) -> tuple[list[list[ObjectStates]], list[ObjectStates]]:
    return run(scene, KalmanBoxTracker3D, pipeline())


def test_the_ego_alone_misses_unseen_objects_and_has_few_false_ones(scene, result):
    scores = score(scene, [tracks[0] for tracks in result[0]])
    assert scores.fn <= 6.35
    assert scores.fp <= 0.05


@pytest.mark.parametrize(
    "other",
    [
        None,
        pipeline(clustering=DBSCANClusterer()),
        pipeline(fusion=CovarianceIntersectionFusion(weights="optimised")),
        pipeline(fusion=BestMemberFusion()),
        CommandCenterPipeline(
            clustering=SampledAssignmentClusterer(),
            group_tracking=UnfilteredGroupTracker(fusion=CovarianceIntersectionFusion()),
        ),
    ],
    ids=["default", "dbscan", "optimised weights", "best member", "unfiltered"],
)
def test_the_picture_misses_few_objects_and_has_few_false_ones_with_every_stage(scene, result, other):
    scores = score(scene, run_again(scene, result[0], other) if other else result[1])
    assert scores.fn <= 1.25
    assert scores.fp <= 0.15
    assert scores.rmse_m <= 0.30
    assert scores.id_switches <= 3


def test_an_agent_that_claims_to_be_certain_beside_the_objects_does_not_ruin_the_picture(scene, result):
    """One of five is 1.9 m off after four seconds, with its covariances scaled by 1e-6.

    The others say how large their errors are, those that last included, so its word counts for more than theirs.
    """
    lying = []
    for time_ns, own in zip(scene.time_ns, result[0], strict=True):
        late = time_ns - scene.time_ns[0] >= 4_000_000_000
        moved = own[2].position + np.array([1.9, 0.0, 0.0])
        false = own[2].with_(position=moved, covariance=1e-6 * own[2].covariance)
        lying.append([*own[:2], false if late else own[2], *own[3:]])
    believed = score(scene, run_again(scene, lying, pipeline(covariances=ReportedCovariances())))
    checked = score(scene, run_again(scene, lying, pipeline()))
    assert believed.rmse_m > 0.7
    assert believed.id_switches > 50
    assert checked.fn <= 0.65
    assert checked.fp <= 0.75
    assert checked.rmse_m <= 0.3
    assert checked.id_switches <= 3


def test_honest_agents_are_believed_to_the_last_bit(scene, result):
    believed = run_again(scene, result[0], pipeline(covariances=ReportedCovariances()))
    for one, other in zip(result[1], believed, strict=True):
        assert_same_bits(one, other)


def run_again(scene: Frames, tracks: list[list[ObjectStates]], centre: CommandCenterPipeline) -> list[ObjectStates]:
    """The pictures of another command centre from the same tracks."""
    names = tuple(f"agent_{row}" for row in range(len(tracks[0])))
    return [
        centre.step(time_ns, concatenate(own), np.repeat(np.arange(len(own)), [len(o) for o in own]), names)[0]
        for time_ns, own in zip(scene.time_ns, tracks, strict=True)
    ]
