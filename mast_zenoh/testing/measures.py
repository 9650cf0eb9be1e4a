"""Checks of metrics."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from mast_zenoh.metrics.user_metrics import Estimate, FrameMetric, Metric
from mast_zenoh.testing import samples
from mast_zenoh.testing.comparison import expect, unchanged

_PER_BOX = [field.name for field in fields(Estimate)][fields(Estimate).index(Estimate.__dataclass_fields__["frame"]) :]


def check_metric(metric: Metric) -> None:
    """Check that a metric has a value for zero, one and 1000 boxes, in any order.

    Raises AssertionError.
    """
    expect(
        metric.label.isidentifier(), f"{type(metric).__name__}: found the label {metric.label!r}, expected a plain name"
    )
    for n in samples.COUNTS:
        for frames in (1, 20):
            _check_value(
                metric, f"{type(metric).__name__} with {n} boxes in {frames} frames", samples.estimate(n, frames)
            )


def _check_value(metric: Metric, subject: str, estimate: Estimate) -> None:
    try:
        with unchanged(subject, estimate=estimate):
            value = metric.value(estimate)
    except Exception as error:
        raise AssertionError(f"{subject}: {type(error).__name__}: {error}") from error
    if isinstance(metric, FrameMetric):
        shape = np.asarray(value).shape
        expect(shape == estimate.frames.shape, f"{subject}: found the shape {shape}, expected {estimate.frames.shape}")
    order = np.random.default_rng(0).permutation(len(estimate.frame))
    shuffled = metric.value(replace(estimate, **{name: getattr(estimate, name)[order] for name in _PER_BOX}))
    same = value is shuffled or np.allclose(
        np.asarray(value, np.float64), np.asarray(shuffled, np.float64), rtol=1e-9, equal_nan=True
    )
    expect(same, f"{subject}: depends on the order of the boxes")
