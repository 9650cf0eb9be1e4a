"""Increments by an attack, from two tables per frame."""

import json

import numpy as np
import pytest

from mast_zenoh.metrics import increments


def table(**series):
    """A table per frame; each series is agent__estimator=[(fn, fp, tp), …]."""
    rows = []
    for name, values in series.items():
        agent, estimator = name.split("__")
        numbered = values.items() if isinstance(values, dict) else enumerate(values)
        rows += [(frame, agent, estimator, *counts) for frame, counts in numbered]
    names = ("frame", "agent", "estimator", "fn", "fp", "tp")
    return {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}


BASELINE = table(
    ego__picture=[(1, 0, 9), (1, 1, 9)],
    ego__local=[(7, 0, 3), (6, 0, 4)],
    infra_1__local=[(4, 0, 6), (4, 1, 6)],
    infra_1__picture=[(1, 0, 9), (1, 1, 9)],
)
ATTACKED = table(
    ego__picture=[(2, 3, 8), (1, 5, 9)],
    ego__local=[(7, 0, 3), (6, 0, 4)],
    infra_1__local=[(6, 5, 4), (5, 4, 5)],
    infra_1__picture=[(2, 3, 8), (1, 5, 9)],
)


def test_increments_are_computed_over_the_baseline_and_over_the_ego_alone():
    result = increments(BASELINE, ATTACKED)
    assert result["frames"] == 2
    assert result["fp"] == {"iob": {"mean": 3.5, "std": 0.5}, "ioe": {"mean": 4.0, "std": 1.0}}
    assert result["fn"] == {"iob": {"mean": 0.5, "std": 0.5}, "ioe": {"mean": -5.0, "std": 0.0}}
    assert result["tp"]["iob"] == {"mean": -0.5, "std": 0.5}


def test_compromised_agents_are_judged_by_their_own_tracks():
    result = increments(BASELINE, ATTACKED, compromised=["infra_1"])
    assert result["cafp"] == {"mean": 4.0, "std": 1.0}
    assert result["cafn"] == {"mean": 1.5, "std": 0.5}
    assert result["compromised"]["infra_1"]["fp"] == {"mean": 4.0, "std": 1.0}


def test_only_common_frames_are_compared_in_any_order():
    some = {name: column[::-1] for name, column in ATTACKED.items()}
    longer = table(
        ego__picture={1: (1, 1, 9), 0: (1, 0, 9), 2: (9, 9, 9)}, ego__local={0: (0, 0, 0), 1: (0, 0, 0), 2: (9, 9, 9)}
    )
    assert increments(longer, some)["fp"]["iob"] == {"mean": 3.5, "std": 0.5}
    assert increments(longer, some, first_frame=1)["fp"]["iob"] == {"mean": 4.0, "std": 0.0}


def test_without_common_frames_there_are_no_values():
    result = increments(BASELINE, ATTACKED, first_frame=9)
    assert result["frames"] == 0
    assert result["fp"]["iob"] == {"mean": None, "std": None}
    json.dumps(result, allow_nan=False)


def test_a_missing_series_is_named():
    with pytest.raises(ValueError, match=r"baseline.*ego/local.*ego/pictures"):
        increments(BASELINE, ATTACKED, estimator="pictures")


def test_the_papers_numbers_of_compromised_agents_are_those_of_the_centre_in_their_range():
    """An adversary on an agent's tracks changes the picture, and never the agent's own tracks."""
    own = {"infra_1__local": [(4, 0, 6), (4, 1, 6)], "ego__local": [(7, 0, 3), (6, 0, 4)]}
    seen = [(1, 0, 9), (1, 1, 9)]
    before = table(ego__picture=seen, infra_1__picture=[(1, 0, 5), (0, 0, 6)], **own)
    after = table(ego__picture=seen, infra_1__picture=[(2, 4, 4), (0, 2, 6)], **own)
    result = increments(before, after, compromised=["infra_1"])
    assert result["cafp"] == result["cafn"] == {"mean": 0.0, "std": 0.0}
    assert result["cafp_centre"] == {"mean": 3.0, "std": 1.0}
    assert result["cafn_centre"] == {"mean": 0.5, "std": 0.5}
