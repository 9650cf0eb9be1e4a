"""Subjects of wires: the names in their keys.

The subject of agent/infra_1/pose is "infra_1". A wire of one of several sensors, agent/infra_1/detections/radar, has
two names in its key: its subject is "infra_1/radar".
"""

from __future__ import annotations


def agent_of(subject: str) -> str:
    """The agent in a subject: its first name."""
    return subject.partition("/")[0]


def part_of(subject: str) -> str:
    """The part of the agent in a subject: its second name; empty without one."""
    return subject.partition("/")[2]


def subject_of(agent: str, part: str) -> str:
    """The subject of a part of an agent, or of the agent itself if `part` is empty."""
    return f"{agent}/{part}" if part else agent
