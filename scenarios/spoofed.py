"""A spoofer shoots at the ego's lidar: from light to points, detections, tracks, the picture and the brake.

Every lidar returns points, and detectors find objects in them. The spoofer is beside the road or on a car, has a budget
of pulses, and must aim, be in sight and hit the right moment. The ego drives by what its agent believes.
"""

from driving import refuse_unused
from driving import scenario as driving

from mast_zenoh.attacks import Attack
from mast_zenoh.sensing import PointCheck, PointDetector
from mast_zenoh.sensing.clutter import Clutter
from mast_zenoh.study.choices import parse_choices, resolve_choice

#: Attacks by name: what the spoofer does, which keeps 10 m ahead of the ego (early_echo: 4 m).
ATTACKS = {
    # 200 points, as many as published: a car that stands 8 m ahead.
    "phantom": dict(type="InjectedPoints", points=200, distance_m=8.0),
    # A wall across the lane.
    "wall": dict(type="GhostWall"),
    # Whatever is in a sector ahead becomes noise.
    "removal": dict(type="HighFrequencyRemoval", sector_deg=20.0),
    # Nothing comes back from a sector ahead.
    "early_echo": dict(type="EarlyEcho", sector_deg=30.0),
}


def scenario(
    attack="phantom",
    attack_start_s=None,
    victim="ego",
    checks=(),
    detector="ClusterDetector",
    detected_by="detector",
    lidar="VLP-32C",
    clutter="Clutter",
    defence=None,
    veto=False,
    estimate="mission",
    scene="intersection",
    scene_index=None,
    n_infrastructure=None,
    n_mobile=None,
):
    """The ego of a generated junction is driven, and its lidar, or that of another agent, is spoofed.

    attack: phantom, wall, removal or early_echo, all by a spoofer ahead of the lidar; a class, such as "Mirror",
    FILE.py or FILE.py:CLASS; or a dict with one of these as `type`, and parameters; "none": no spoofer;
    attack_start_s: start of the attack, in scene time; None: as its class says, 4 s for those that come with mast;
    victim: the agent whose lidar it is;
    checks: of detections against points, such as "OcclusionCheck", separated by commas: what they refuse is left out;
    detector: "ClusterDetector", FILE.py:CLASS or a dict; detected_by: detector (a node), agent or simulator;
    lidar: a model of all agents, such as "VLP-32C"; None: their own; clutter: what stands beside roads, or None;
    defence, veto, estimate: as for the scenario `driving`.
    """
    content = driving(
        defence=defence,
        veto=veto,
        estimate=estimate,
        scene=scene,
        scene_index=scene_index,
        n_infrastructure=n_infrastructure,
        n_mobile=n_mobile,
    )
    finds = resolve_choice(detector, PointDetector)
    checks = [resolve_choice(check, PointCheck) for check in parse_choices(checks, "checks")]
    if checks:
        finds = dict(type="CheckedDetector", detector=finds, checks=checks)
    beside = None if clutter is None else resolve_choice(clutter, Clutter)
    points = dict(lidar=lidar, clutter=beside, detector=finds, detected_by=detected_by)
    content |= dict(name="spoofed", points=points)
    if attack == "none":
        refuse_unused("an attack", attack_start_s=attack_start_s)
        return content
    attack = ATTACKS.get(attack, attack) if isinstance(attack, str) else attack
    attack = ({} if attack_start_s is None else dict(start_s=attack_start_s)) | resolve_choice(attack, Attack)
    maps = content["keyexpr"]
    return content | dict(
        adversaries=dict(spoofer_1=dict(type="Adversary", agent=victim, attack=attack)),
        keyexpr=maps | dict(rewrites=[*maps["rewrites"], "on_points.toml"]),
    )
