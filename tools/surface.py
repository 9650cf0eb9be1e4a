"""What users may rely on besides `mast_zenoh.__all__`: base classes, and members of a run (docs/stability.md)."""

from __future__ import annotations

#: Base classes (of a message type: the classes that describe it) as `module.Class`, by purpose.
BASE_CLASSES: dict[str, tuple[str, ...]] = {
    "node": ("mast_zenoh.node.Node", "mast_zenoh.node.Source"),
    "message type": ("mast_zenoh.messages.Schema", "mast_zenoh.messages.Column"),
    "attack": (
        "mast_zenoh.attacks.Attack",
        "mast_zenoh.attacks.Coordination",
        "mast_zenoh.attacks.AdaptiveAttack",
        "mast_zenoh.attacks.FollowingEgo",
        "mast_zenoh.attacks.FalseTraffic",
        "mast_zenoh.attacks.PointAttack",
        "mast_zenoh.attacks.point_attacks.AttackedScan",
    ),
    "part of an attack": (
        "mast_zenoh.attacks.Selection",
        "mast_zenoh.attacks.Propagation",
        "mast_zenoh.attacks.Imitation",
    ),
    "tracker": ("mast_zenoh.tracking.Tracker", "mast_zenoh.tracking.Assignment"),
    "fusion": (
        "mast_zenoh.fusion.pipelines.Pipeline",
        "mast_zenoh.fusion.Clusterer",
        "mast_zenoh.fusion.Fusion",
        "mast_zenoh.fusion.GroupTracker",
    ),
    "integrity stage": ("mast_zenoh.integrity.Integrity",),
    "driver": ("mast_zenoh.driving.Driver",),
    "detector or check of points": ("mast_zenoh.sensing.PointDetector", "mast_zenoh.sensing.PointCheck"),
    "scene": ("mast_zenoh.scenes.Scene", "mast_zenoh.sensing.Detector", "mast_zenoh.scenes.Sensor"),
    "metric": ("mast_zenoh.metrics.FrameMetric", "mast_zenoh.metrics.RunMetric", "mast_zenoh.metrics.Assigner"),
    "link rule": ("mast_zenoh.links.Rule",),
    "fault": ("mast_zenoh.faults.Fault",),
    "rule of the radio": (
        "mast_zenoh.v2x.GenerationRules",
        "mast_zenoh.v2x.RedundancyRule",
        "mast_zenoh.v2x.CongestionControl",
        "mast_zenoh.v2x.CamGeneration",
        "mast_zenoh.v2x.RadioChannel",
    ),
    "check": ("mast_zenoh.launch.checks.RunCheck",),
    "report figure": ("mast_zenoh.show.RunFigure",),
    "deployment engine": ("mast_zenoh.launch.engine.Engine",),
}

#: Members of a run that users may rely on. Its other attributes are for what shows runs, and may change.
OF_A_RUN = (
    *("record", "id", "name", "seed", "status", "running", "headline", "findings", "summary", "agents", "agent"),
    *("metrics", "objects", "attacks", "targets", "driving", "driven", "trust", "trust_objects"),
    *("messages", "truth", "picture", "plot", "report", "export", "animate", "snapshot"),
)
