"""Generation rules of Cooperative Awareness Messages: when a station says where it is."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.v2x import CamGeneration

FRAME_NS = 100_000_000


def generated(rules: CamGeneration, frame: int, x: float = 0.0, v: float = 0.0, yaw: float = 0.0) -> bool:
    """Whether a CAM is sent in a frame of 100 ms."""
    return rules.generate(frame * FRAME_NS, np.array([x, 0.0, 0.0]), np.array([v, 0.0, 0.0]), yaw).generated


@pytest.mark.parametrize(
    ("change", "due"),
    [
        (dict(x=4.0), False),
        (dict(x=4.1), True),
        (dict(v=0.5), False),
        (dict(v=0.6), True),
        (dict(yaw=math.radians(3.9)), False),
        (dict(yaw=math.radians(-4.1)), True),
        (dict(yaw=math.radians(357.0)), False),
    ],
)
def test_a_station_that_moves_turns_or_accelerates_sends_at_once(change: dict[str, float], due: bool) -> None:
    rules = CamGeneration()
    generated(rules, 0)
    assert generated(rules, 1, **change) is due


def test_after_a_change_three_more_follow_at_its_interval() -> None:
    rules = CamGeneration()
    frames = [frame for frame in range(40) if generated(rules, frame, v=0.0 if frame < 3 else 5.0)]
    assert frames == [0, 3, 6, 9, 12, 22, 32]


def test_a_cam_waits_for_the_least_interval() -> None:
    rules = CamGeneration(least_s=0.4)
    assert [frame for frame in range(13) if generated(rules, frame, x=20.0 * frame)] == [0, 4, 8, 12]


def test_the_low_frequency_container_comes_every_half_second() -> None:
    rules = CamGeneration()
    decisions = [
        rules.generate(frame * FRAME_NS, np.array([20.0 * frame, 0.0, 0.0]), np.zeros(3), 0.0) for frame in range(12)
    ]
    assert all(decision.generated for decision in decisions)
    assert [frame for frame, decision in enumerate(decisions) if decision.low_frequency] == [0, 5, 10]


@given(moves=st.lists(st.floats(0.0, 10.0), max_size=60), interval_s=st.floats(0.1, 1.0))
def test_a_station_is_never_silent_for_longer_than_a_second(moves: list[float], interval_s: float) -> None:
    rules = CamGeneration(least_s=interval_s)
    sent = [frame for frame, x in enumerate(np.cumsum(moves)) if generated(rules, frame, x=float(x))]
    assert all(1 <= later - earlier <= 10 for earlier, later in pairwise(sent))
