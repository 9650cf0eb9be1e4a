"""Faults on a timeline and their effects on links, processes and the host network.

    base         base class of faults
    impairments  faults of messages
    sensors      faults of detections
    churn        faults of processes
    targets      nodes and links that a fault acts on
    plan         conversion of faults to link rules, process steps and bands of the timeline
    network      hosts and their links
    schedule     random lists of faults

Pure: these modules start, kill and send nothing. See docs/faults.md.
"""

from mast_zenoh.config.process_steps import ACTIONS, ProcessStep
from mast_zenoh.faults.base import Fault
from mast_zenoh.faults.churn import Join, Kill, Leave, Pause, ProcessFault, Restart, Unplug
from mast_zenoh.faults.impairments import (
    BandwidthLimit,
    BurstLoss,
    Corrupt,
    Delay,
    Duplicate,
    Flood,
    Impair,
    LinkFault,
    Loss,
    Partition,
    Reorder,
    SlowNode,
)
from mast_zenoh.faults.plan import Plan, plan
from mast_zenoh.faults.schedule import random_schedule
from mast_zenoh.faults.sensors import BlindSector, GhostDetections, SensorFault

__all__ = [
    "ACTIONS",
    "BandwidthLimit",
    "BlindSector",
    "BurstLoss",
    "Corrupt",
    "Delay",
    "Duplicate",
    "Fault",
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
    "Plan",
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
