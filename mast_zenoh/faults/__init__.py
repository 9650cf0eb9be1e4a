"""Faults on a timeline and their effects on links, processes and the host network.

    base      the faults: of messages, of detections, of processes
    plan      conversion of faults to link rules, process steps and bands of the timeline; random lists of faults
    network   hosts and their links

Pure: these modules start, kill and send nothing. See docs/how-to-scenarios.md#faults.
"""

from mast_zenoh.config.resolved import ACTIONS, ProcessStep
from mast_zenoh.faults.base import (
    BandwidthLimit,
    BlindSector,
    BurstLoss,
    Corrupt,
    Delay,
    Duplicate,
    Fault,
    Flood,
    GhostDetections,
    Impair,
    Join,
    Kill,
    Leave,
    LinkFault,
    Loss,
    Partition,
    Pause,
    ProcessFault,
    Reorder,
    Restart,
    SensorFault,
    SlowNode,
    Unplug,
)
from mast_zenoh.faults.plan import FaultPlan, plan, random_schedule

__all__ = [
    "ACTIONS",
    "BandwidthLimit",
    "BlindSector",
    "BurstLoss",
    "Corrupt",
    "Delay",
    "Duplicate",
    "Fault",
    "FaultPlan",
    "Flood",
    "GhostDetections",
    "Impair",
    "Join",
    "Kill",
    "Leave",
    "LinkFault",
    "Loss",
    "Partition",
    "Pause",
    "ProcessFault",
    "ProcessStep",
    "Reorder",
    "Restart",
    "SensorFault",
    "SlowNode",
    "Unplug",
    "plan",
    "random_schedule",
]
