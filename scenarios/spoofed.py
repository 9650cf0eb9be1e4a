"""A spoofer shoots at the ego's lidar: from light to points, detections, tracks, the picture and the brake.

Every lidar returns points, and detectors find objects in them. The spoofer is beside the road or on a car, has a budget
of pulses, and must aim, be in sight and hit the right moment. The ego drives by what its agent believes.
"""

from driving import refuse_unused
from driving import scenario as driving

from mast_zenoh.attacks import Attack
from mast_zenoh.config import plugins, registry
from mast_zenoh.errors import ConfigurationError
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
    checks="none",
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

    attack: phantom, wall, removal or early_echo, all by a spoofer ahead of the lidar; a class of an attack on points,
    such as "Mirror", FILE.py or FILE.py:CLASS; or a dict with one of these as `type`, and parameters; none: no spoofer;
    attack_start_s: start of the attack, in scene time; None: as its class says, 4 s for those that come with mast;
    victim: the agent whose lidar it is;
    checks: of detections against points, such as "OcclusionCheck", FILE.py or FILE.py:CLASS, separated by commas, or
    none: what they refuse is left out, also true objects (docs/explanation-points.md);
    detector: "ClusterDetector", FILE.py:CLASS or a dict; detected_by: detector (a node), agent or simulator;
    lidar: a model of all agents, such as "VLP-32C"; none: their own; clutter: what stands beside roads, or none;
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
    checks = [resolve_choice(check, PointCheck) for check in parse_choices(checks, "checks") if check != "none"]
    if checks:
        finds = dict(type="CheckedDetector", detector=finds, checks=checks)
    beside = None if is_none(clutter) else resolve_choice(clutter, Clutter)
    lidar = None if is_none(lidar) else lidar
    points = dict(lidar=lidar, clutter=beside, detector=finds, detected_by=detected_by)
    content |= dict(name="spoofed", points=points)
    if is_none(attack):
        refuse_unused("an attack", attack_start_s=attack_start_s)
        return content
    attack = ({} if attack_start_s is None else dict(start_s=attack_start_s)) | attack_on_points(attack)
    maps = content["keyexpr"]
    return content | dict(
        adversaries=dict(spoofer_1=dict(type="Adversary", agent=victim, attack=attack)),
        keyexpr=maps | dict(rewrites=[*maps["rewrites"], "on_points.toml"]),
    )


def is_none(choice):
    """Whether a choice is None, as text or not."""
    return str(choice).lower() == "none"


def attack_on_points(attack):
    """An attack as a dict. Raises ConfigurationError for a class that is unknown, or that changes no points."""
    attack = resolve_choice(ATTACKS.get(attack, attack) if isinstance(attack, str) else attack, Attack)
    name, classes = attack["type"], registry.known_types(Attack, attack["type"])
    on_points = [known for known, cls in classes.items() if cls.forge_points is not Attack.forge_points]
    if name not in classes:
        raise plugins.not_found(f"attack: no attack named {name!r}", name, [*ATTACKS, *on_points])
    if name not in on_points:
        raise ConfigurationError(f"attack: {name} changes no points, expected one of {', '.join(on_points)}")
    return attack
