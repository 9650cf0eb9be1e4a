"""Values that a parameter cannot have are refused with its name, in every room that computes."""

from math import inf, nan
from typing import Any

import numpy as np
import pytest

from mast_zenoh import attacks, driving, fusion, integrity, metrics, tracking, v2x
from mast_zenoh.attacks import attack, coordination, disputes, evasion, regions, road_ahead
from mast_zenoh.attacks.attack import CoordinatedAttack
from mast_zenoh.attacks.flood import MAX_ROWS, Flood
from mast_zenoh.attacks.real_objects import SlowDrift
from mast_zenoh.attacks.selection import ConflictSelection
from mast_zenoh.driving.following import IntelligentDriverModel
from mast_zenoh.fusion.input_limit import FairInput
from mast_zenoh.fusion.pipelines.heard import HeardTracks
from mast_zenoh.fusion.regions import Around, Rectangle
from mast_zenoh.sensing import DetectionModel, LastingErrors, LidarSensor
from mast_zenoh.v2x.congestion import AdaptiveDcc, ReactiveDcc

NOT_POSITIVE = [0.0, -1.0, nan, inf]
#: By class, the values that each of its parameters refuses.
REFUSED: dict[Any, dict[str, list[Any]]] = {
    attacks.UncoordinatedSelection: dict(
        fraction_false_negatives=[1.4], n_false_positives=[-1.0, 10_001.0, nan], object_class=["cra"],
        box=[(4.0, 0.0, 2.0)]),
    attacks.UncoordinatedAttack: dict(start_s=[-5.0], reselect_every_s=[0.0]),
    CoordinatedAttack: dict(start_s=[-5.0]),
    coordination.Coordinator: dict(start_s=[-5.0]),
    Flood: dict(rows=[0, MAX_ROWS + 1], spacing_m=[0.0], score=[1.5]),
    regions.FewWitnesses: dict(most=[-1]),
    regions.ManyWitnesses: dict(least=[0]),
    ConflictSelection: dict(n_objects=[0], horizon_s=[0.0]),
    road_ahead.PhantomQueue: dict(ahead_m=[0.0], spacing_m=[inf]),
    road_ahead.CutIn: dict(change_s=[0.0], side=["lef"]),
    road_ahead.HideAhead: dict(horizon_s=[-1.0], what=["crosing"]),
    road_ahead.LaneIntrusion: dict(into=["egg"], rate_mps=[0.0]),
    attack.SeizedCommands: dict(start_s=[-1.0], end_s=[nan, -1.0], acceleration=[inf]),
    SlowDrift: dict(budget=NOT_POSITIVE),
    disputes.PairedDenial: dict(witnesses=[-1], budget=[0.0], tolerance=[2.0]),
    evasion.PosePert: dict(offset_m=[0.0, 1.1, -0.5, nan], direction=["sideway"], end_s=[nan, -1.0]),
    evasion.BlindAreaConfusion: dict(action=["inserts"]),
    evasion.PretendBenign: dict(
        memory_s=[0.0], duty=[0.0, 1.0], inspected_share=[0.0], tolerance=[-1.0], start_s=[-1.0]),
    integrity.Hearsay: dict(weight=[-0.1, 0.6, nan]),
    integrity.SequentialConsistency: dict(
        contradiction_tail=[(10.0, 0.0)], deviation_tail=[(10.0, 0.0)], pair_tail=[(10.0, 0.0)]),
    integrity.Robosac: dict(
        ego=[""], attackers=[-1, inf], budget=[0, 2.5, None], sample_size=[0, True], confidence=[1.0], agree=[1.1],
        match_iou=[0.0], area_m=[0.0]),
    integrity.Pasac: dict(
        agree=[-0.1], smoothing=[2.0], deeper=[-1.0], window=[0, 2.5], least_scores=[0, 2.5], adaptive=["no"],
        ego=[None]),
    integrity.Made: dict(
        alpha=[0.0], calibration=[(), (1.0, nan), (-1.0,), "many"], area_m=[0.0], dependent=["no"], ego=[3]),
    integrity.PoseGuard: dict(ego=[""], region_m=[0.0], agree_m=[-1.0], record_s=[0.0]),
    integrity.Prbi: dict(
        agree=[2.0], short_term=[-0.1], memory=[0, 501, 2.5, True], settled=[1, 2.5], level=[0.0], match_iou=[1.5]),
    integrity.Cad: dict(threshold_m2=[0.0], range_m=[-1.0], link_m=[0.0], record_s=[0.0]),
    metrics.Consistency: dict(samples_per_s=[0.0, nan], limit=[0.9]),
    metrics.CenterDistanceAssigner: dict(gate_m=[0.0], dimensions=[1]),
    metrics.IoU3DGreedyAssigner: dict(threshold=[1.5]),
    metrics.SetDistance: dict(dimensions=[1], c=[0.0], p=[0.5], alpha=[3.0]),
    v2x.CpmGeneration: dict(least_s=[2.0], type_a=[["horse"]], priority_moved_m=[[8.0, 0.0]], moved_m=[-1.0]),
    v2x.CamGeneration: dict(least_s=[2.0]),
    v2x.OfdmTiming: dict(bit_rate_mbps=[5.5]),
    ReactiveDcc: dict(intervals_s=[(1.0,)], bounds=[(0.5, 0.2, 0.6, 0.7, 0.8, 0.9)]),
    AdaptiveDcc: dict(target=[1.5], least=[0.1]),
    tracking.KalmanBoxTracker3D: dict(
        detection_probability=[-1.0], clutter_per_m2=[-1.0], position_std_m=[-1.0], jump_probability=[-1.0],
        lasting_share=[1.5]),
    tracking.InteractingModelsTracker3D: dict(turn_s=[-1.0], position_std_m=[-1.0]),
    fusion.CheckedCovariances: dict(least_speed_std_mps=[0.0], limit=[0.5]),
    fusion.CovarianceIntersectionFusion: dict(independent_share=[1.1]),
    fusion.SampledAssignmentClusterer: dict(bias_m=[0.0]),
    fusion.DBSCANClusterer: dict(gate=[-1.0]),
    FairInput: dict(rows=[0], reserve=[1.5], memory_frames=[0]),
    Rectangle: dict(y_max_m=[-inf]),
    Around: dict(radius_m=[0.0]),
    driving.CarLimits: dict.fromkeys(("acceleration", "braking", "curvature"), NOT_POSITIVE),
    IntelligentDriverModel: dict.fromkeys(("acceleration", "braking", "headway_s", "gap_m", "exponent"), NOT_POSITIVE),
    driving.ProposalDriver: dict(drivable_m=[0.0], preview_s=[0.0], preview_m=[0.0]),
    LastingErrors: dict(error_s=[0], miss_s=[0], clutter_s=[0], white_share=[2]),
    DetectionModel: dict(
        points_scale=[0.0, 1001.0], clutter_rate=[-1.0, 1001.0], wrong_class=[1.5], score=[(0.9, 0.3)], white=["no"],
        few_points=[-1.0], error_s=[0.0], miss_s=[0.0], clutter_s=[0.0], blip_s=[0.0], view_share=[1.5],
        white_share=[1.5], lasting_clutter=[1.5], view_angle_deg=[20.0], range_scale_m=[1001.0],
        position_noise_m=[1001.0], min_points=[1001.0]),
    LidarSensor: dict(
        mount_position=[np.zeros(2)], mount_rotation=[np.full((3, 3), nan)], azimuth_step_deg=[0.0, 1e-4],
        azimuth_max_deg=[200.0], elevation_max_deg=[-25.0], channels=[0], max_range_m=[inf]),
    HeardTracks: dict(memory_s=[-1.0]),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED, ids=lambda kind: kind.__name__)
def test_a_value_that_cannot_be_is_refused_with_the_name_of_its_parameter(kind):
    for name, values in REFUSED[kind].items():
        for value in values:
            with pytest.raises(ValueError, match=rf"\b{name}\b[^:]*: found "):
                kind(**{name: value})
