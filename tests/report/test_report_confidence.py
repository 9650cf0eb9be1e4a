"""The report compares the confidence of every estimate with its accuracy."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mast_zenoh.metrics import Consistency
from mast_zenoh.runs.run import Run
from mast_zenoh.show.html import write_report
from mast_zenoh.show.number_text import DASH
from mast_zenoh.show.tables.of_run import confidence_tables, nees_table
from mast_zenoh.tracking import Innovations


def summary(scale: float, n: int = 400) -> dict[str, Any]:
    """Of an estimate with `scale` times the expected NEES."""
    values = scale * np.random.default_rng(0).chisquare(2, n)
    return Consistency().nees_summary(values, np.arange(n) % 40, 0.1)


def confident() -> dict[str, dict[str, Any]]:
    """Changes of the files of a run: estimates and trackers whose confidence was measured."""
    none = Consistency().nees_summary(np.full(3, np.nan), np.zeros(3, int), 0.1)
    consistency = {
        "ego": {"picture": {"position": summary(0.9), "velocity": summary(0.1)}},
        "infra_1": {"received": {"position": summary(9.0), "velocity": summary(9.0)}},
        "infra_2": {"local": {"position": none, "velocity": none}},
    }
    innovations = {"ego": Innovations(190.0, 100, 1).summary(), "infra_1": Innovations().summary()}
    return dict(metrics={"consistency": consistency}, run={"innovations": innovations})


@pytest.fixture
def folder(run_folder: Callable[..., Path]) -> Path:
    return run_folder("uncoordinated", **confident())


def test_an_overconfident_estimate_is_marked_and_told_how_much(folder: Path) -> None:
    table = confidence_tables(Run(folder))[0]
    assert table.bad == [False, True, False]
    assert float(table.lines[1][2].split()[0]) == pytest.approx(3.0, rel=0.2)


def heavy_tailed() -> dict[str, Any]:
    """Of an estimate most of whose errors are as its covariances say, and some far beyond."""
    values = np.random.default_rng(0).chisquare(2, 400)
    return Consistency().nees_summary(np.where(np.arange(400) % 10, values, 400.0), np.arange(400) % 40, 0.1)


def test_a_mean_above_its_bounds_is_named_though_the_median_is_as_expected(run_folder: Callable[..., Path]) -> None:
    picture = {"picture": {"position": heavy_tailed(), "velocity": summary(0.9)}}
    assert picture["picture"]["position"]["verdict"] is None
    folder = run_folder(metrics={"consistency": {"ego": picture}})
    (line,) = confidence_tables(Run(folder))[0].lines
    assert "position: NEES above" in line[-1]


@pytest.mark.usefixtures("without_figures")
def test_of_many_estimates_those_of_other_agents_are_folded(run_folder: Callable[..., Path]) -> None:
    good, bad = ({"picture": dict.fromkeys(("position", "velocity"), summary(scale))} for scale in (1.0, 9.0))
    consistency = {"ego": good, "infra_1": bad} | {f"mobile_{i}": good for i in range(12)}
    folder = run_folder(metrics={"consistency": consistency, "pictures": {}})
    shown, _, folded = confidence_tables(Run(folder))
    assert [line[0] for line in shown.lines] == ["the picture of ego", "the picture of infra_1"]
    assert len(folded.lines) == 12
    page = write_report(folder).read_text()
    assert "<details><summary>12 estimates of the other agents</summary>" in page


def test_compared_runs_have_the_nees_of_the_picture_beside_each_other() -> None:
    picture = {"picture": {"position": heavy_tailed(), "velocity": summary(0.9)}}
    metrics = {"naive": {"consistency": {"ego": picture}}, "none": {}}
    table = nees_table(metrics, "ego")
    position, velocity = (picture["picture"][name]["nees"] for name in ("position", "velocity"))
    assert table.lines == [["naive", f"{position:.2f}*", f"{velocity:.2f}", DASH, DASH]]
    assert table.bad == [True]
