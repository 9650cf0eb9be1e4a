"""After its table, a study runs a car with a driver and its twin; the report says what happened, or the error does."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import mast_zenoh as mast
from mast_zenoh.errors import HandlerFailed

pytestmark = pytest.mark.heavy

STUDY = """
from mast_zenoh.driving import Driver, FollowingDriver


class Fails(Driver):
    def drive(self, situation):
        raise RuntimeError("no driver")


def study(driver="FollowingDriver"):
    place = dict(n_infrastructure=1)
    driven = dict(attack="GhostAhead", attack_start_s=0.5, driver=driver)
    return dict(
        runs=dict(baseline=dict(scenario="baseline", parameters=place)),
        driven=dict(scenario="driving", parameters=place | driven, frames=20),
        runtime="inproc",
    )
"""


def test_the_report_of_a_study_says_what_its_driven_car_did(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(STUDY)
    finished = mast.study(str(tmp_path / "mine.py"), frames=12, out=tmp_path / "study")
    assert list(finished.runs) == ["baseline"], "it is not one of the compared runs"
    for folder in ("driven", "driven/twin"):
        metrics = json.loads((finished.path / folder / "metrics.json").read_text())
        assert (metrics["frames"], [*metrics["driven"]]) == (12, ["ego"])
    assert (finished.path / "figures" / "driven.png").is_file()
    page = finished.report.read_text()
    assert "What the car did" in page
    way = json.loads((finished.path / "driven" / "metrics.json").read_text())["driven"]["ego"]["progress_m"]
    assert f"The ego drives {way:.0f} m" in page


def test_a_driver_that_fails_does_not_cost_the_report_and_is_the_error_of_the_study(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(STUDY)
    failing = f"{tmp_path / 'mine.py'}:Fails"
    with pytest.raises(HandlerFailed, match="no driver"):
        mast.study(str(tmp_path / "mine.py"), frames=8, out=tmp_path / "study", driver=failing)
    page = (tmp_path / "study" / "report.html").read_text()
    assert "What the car did" not in page
    assert "baseline" in page
