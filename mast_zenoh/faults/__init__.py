"""Faults as a user writes them on one timeline, and what they mean for links, processes and the host network.

    base       what a fault is
    impairments  what happens to messages
    churn      what happens to processes
    targets    whom a fault hits
    plan       a list of faults → rules of links, steps of processes, bands of the timeline
    network    hosts and their links
    schedule   random lists of faults

Pure: nothing here starts, kills or sends. See docs/faults.md.
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

__all__ = [
    "ACTIONS",
    "BandwidthLimit",
    "BurstLoss",
    "Corrupt",
    "Delay",
    "Duplicate",
    "Fault",
    "Flood",
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
    "SlowNode",
    "Unplug",
    "plan",
    "random_schedule",
]
