"""Synthetic study rows: grids of configurations with all estimates."""

import itertools
from collections.abc import Sequence
from typing import Any

from mast_zenoh.metrics.study_results import FailedTrial, Row, Statistic, StudyFacts, StudySeries

BASELINE = Row(
    {"configuration": "baseline"},
    0,
    {StudySeries("", "picture", "fp"): Statistic(mean=1.0, std=0.5, value=1.0, low=0.9, high=1.1)},
)


def estimate(mean: float, half: float = 0.5, p: float = 1e-9, seeds: int = 20) -> Statistic:
    return Statistic(mean=mean, std=1.25, value=mean, low=mean - half, high=mean + half, p=p, scenes=3, seeds=seeds)


def row(run: str, point: dict[str, Any], fp: float) -> Row:
    """A configuration that adds `fp` false objects to picture and mission."""
    estimates = {
        StudySeries("", "picture", "fp"): estimate(1.0 + fp, p=float("nan")),
        StudySeries("", "picture", "fp inserted"): Statistic(mean=2.0),
        StudySeries("", "picture", "fp clutter"): Statistic(mean=1.0),
        StudySeries("", "picture", "fp lag"): Statistic(mean=0.0),
        StudySeries("", "mission", "my_metric"): estimate(7.5, p=float("nan")),
        StudySeries("compromised", "local", "cafp_iob"): estimate(2.0 * fp),
        StudySeries("all", "achieved", "accepted"): Statistic(
            mean=0.9, value=0.9, low=0.7, high=1.0, seeds=20, rate=True
        ),
        StudySeries("adversary_1", "achieved", "accepted"): Statistic(
            mean=0.4, value=0.4, low=0.2, high=0.6, rate=True
        ),
    }
    for estimator in ("picture", "mission"):
        estimates[StudySeries("", estimator, "fp_iob")] = estimate(fp)
        estimates[StudySeries("", estimator, "fn_iob")] = estimate(-0.004, 0.02, p=0.4)
    for metric in ("fn_iob", "fp_iob", "tp_iob", "rmse_m_iob", "id_switches_iob"):
        estimates[StudySeries("", "local", metric)] = Statistic(
            mean=0.0, std=0.0, value=0.0, zero_share=1.0, scenes=3, seeds=20
        )
    return Row({"configuration": "-".join([run, *map(str, point.values())]), **point}, 0, estimates)


def grid(run: str, factor: float = 3.0, **values: Sequence[Any]) -> list[Row]:
    """A row per grid point; the first parameter sets the false objects."""
    first = next(iter(values.values()))
    return [
        row(run, dict(zip(values, point, strict=True)), factor * (first.index(point[0]) + 1))
        for point in itertools.product(*values.values())
    ]


def facts(rows: Sequence[Row], failed: Sequence[FailedTrial] = ()) -> StudyFacts:
    missing = [each.configuration for each in failed]
    return StudyFacts(
        name="made",
        baseline="baseline",
        configurations={row.configuration: ("uncoordinated", ("n=1",)) for row in rows},
        scenes=("intersection:0", "intersection:1", "intersection:2"),
        seeds=tuple(range(20)),
        frames=150,
        runtime="inproc",
        done={row.configuration: 60 - missing.count(row.configuration) for row in rows},
        failed=tuple(failed),
        environment={"mast-zenoh": "0.1.0", "code": "0123abcd"},
    )
