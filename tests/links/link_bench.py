"""Sends messages of one wire through the rules of a link."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw
from mast_zenoh.arrays.states import Detections
from mast_zenoh.config import registry
from mast_zenoh.links import Chain, Passage, PassageOutcome, Rule, SenderPose, Sensed
from mast_zenoh.streams import stream

PERIOD_NS = 100_000_000


def build(**spec: Any) -> Rule:
    """Build a rule from its dict, as a scenario does."""
    rule = registry.build(spec, Rule, "link.rules_up[0]")
    assert isinstance(rule, Rule)
    return rule


def sensed(*places: tuple[float, float], x: float = 0.0, turn: float = 0.0, mobile: bool = False) -> Sensed:
    """Cars that a sensor detects, 2 m above the ground, at (x, y) m in its frame.

    x: m, of its agent; turn: rad, its heading; mobile: it drives ahead at 10 m/s
    """
    n = len(places)
    detections = Detections(
        np.array([(*place, -1.25) for place in places]).reshape(n, 3),
        np.tile([4.5, 1.8, 1.5], (n, 1)),
        np.zeros(n),
        np.ones(n),
        np.zeros(n, np.uint8),
        np.zeros((n, 3, 3)),
    )
    rotation = quaternion_from_rotation(rotation_from_yaw(turn))
    velocity = rotation_from_yaw(turn) @ np.array([10.0 if mobile else 0.0, 0.0, 0.0])
    pose = SenderPose(0, np.array([x, 0.0, 0.0]), rotation, velocity, 0.0)
    return Sensed(detections, np.array([0.0, 0.0, 2.0]), np.eye(3), pose)


def chain(rules: Sequence[dict[str, Any]], seed: int = 0) -> Chain:
    """The rules of one wire."""
    return Chain([build(**rule) for rule in rules], lambda *purpose: stream(seed, "link_1", "link", "tracks", *purpose))


def carry(
    rules: Sequence[dict[str, Any]], count: int, *, seed: int = 0, every_ns: int = PERIOD_NS, **fields: Any
) -> list[PassageOutcome]:
    """The outcomes of `count` messages, one every `every_ns`."""
    wire = chain(rules, seed)
    return [wire.carry(Passage(i * every_ns, i * every_ns, **fields)) for i in range(count)]


def arrived(outcomes: Sequence[PassageOutcome]) -> np.ndarray:
    """(n,) bool: which messages arrived."""
    return np.array([bool(outcome.leaving) for outcome in outcomes])


def delays(outcomes: Sequence[PassageOutcome]) -> np.ndarray:
    """(n,) s: the delay of each copy that arrived."""
    return np.array([delay_s for outcome in outcomes for _, delay_s in outcome.leaving])
