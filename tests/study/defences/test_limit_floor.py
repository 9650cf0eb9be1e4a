"""The least delay with which a displaced object can be noticed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.study.defences.drift import (
    EVIDENCE,
    INDEPENDENT_PER_S,
    TRACK_SD_M,
    drift_floor_s,
    offset_floor_s,
    speed_up,
)


@pytest.mark.parametrize(("offset_m", "delay_s"), [(0.3, 14.07), (0.5, 5.07), (1.0, 1.27)])
def test_a_constant_offset_takes_as_long_as_its_evidence(offset_m: float, delay_s: float) -> None:
    assert offset_floor_s(offset_m) == pytest.approx(delay_s, abs=0.01)


@pytest.mark.parametrize(("rate_mps", "offset_m"), [(0.05, 0.57), (0.1, 0.72), (0.2, 0.91)])
def test_a_drift_reaches_an_offset_before_anybody_can_know(rate_mps: float, offset_m: float) -> None:
    assert rate_mps * drift_floor_s(rate_mps) == pytest.approx(offset_m, abs=0.01)


@given(st.floats(0.01, 1.0))
def test_the_evidence_of_a_drift_is_the_sum_of_that_of_its_offsets(rate_mps: float) -> None:
    steps = 2000
    step_s = drift_floor_s(rate_mps) / steps
    offsets = (rate_mps * (index + 0.5) * step_s for index in range(steps))
    evidence = sum(INDEPENDENT_PER_S * step_s * offset**2 / (2.0 * TRACK_SD_M**2) for offset in offsets)
    assert evidence == pytest.approx(EVIDENCE, rel=1e-4)


def test_eight_witnesses_need_half_the_time_and_none_never_know() -> None:
    assert speed_up([0, 1, 8]).tolist() == pytest.approx([0.0, 1.0, 2.0])


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("inf"), float("nan")])
def test_what_does_not_move_has_no_floor(wrong: float) -> None:
    with pytest.raises(ValueError, match="offset_m"):
        offset_floor_s(wrong)
    with pytest.raises(ValueError, match="rate_mps"):
        drift_floor_s(wrong)
