"""A generic study whose runs have a defence shows what it did."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_outcomes import outcome, study

from mast_zenoh.metrics.study_results import StudyRow
from mast_zenoh.report.html import write_study_report
from mast_zenoh.report.narrative.study import compare
from mast_zenoh.report.tables.study import sections
from mast_zenoh.study import definition, interface
from mast_zenoh.study.numbers import numbers, values
from mast_zenoh.study.tables import Samples


def integrity(delays_s: list[float | None], false_alarms: int = 0) -> dict[str, Any]:
    """A lying agent for each delay, None: never suspended; and an honest one."""
    agents: dict[str, Any] = {
        f"infra_{index}": {"lied": True, "suspended_after_s": delay_s} for index, delay_s in enumerate(delays_s)
    }
    agents["ego"] = {"lied": False, "suspended_after_s": None}
    honest = ["ego"] if false_alarms else []
    withheld = {"false": 1.5, "true": 0.25}
    return {"agents": agents, "honest_suspended": honest, "false_alarms": false_alarms, "withheld": withheld}


def test_suspensions_delays_false_alarms_and_withheld_objects_are_numbers_of_the_defence() -> None:
    listed = {each.metric: each.value for each in numbers({"integrity": integrity([2.0, 4.0, None], 3)})}
    assert listed == {
        "lying_agents": 3.0,
        "lying_suspended": 2.0,
        "delay_s": 3.0,
        "honest_suspended": 1.0,
        "false_alarms": 3.0,
        "withheld_false": 1.5,
        "withheld_true": 0.25,
    }


def test_a_defence_that_suspends_nobody_has_no_delay() -> None:
    listed = {each.metric: each.value for each in numbers({"integrity": integrity([None])})}
    assert np.isnan(listed["delay_s"])


def rows(defended: bool) -> list[StudyRow]:
    samples = Samples(study({"attacked": {}}, scenes=1), range(5))
    for seed in range(5):
        for label, delays_s in (("baseline", []), ("attacked", [1.0 + seed])):
            trial = outcome(label, 0, seed)
            if defended:
                trial.metrics["integrity"] = integrity(delays_s)  # type: ignore[index]
            samples.add(trial, values(trial, None))
    return samples.rows()


def test_the_table_of_a_study_has_the_defences_numbers_with_intervals() -> None:
    tables = {each.title: each for each in sections(rows(True), "baseline", compare(rows(True), "baseline"))}
    table = tables["What the defence did"]
    assert table.terminal
    attacked = dict(zip(table.headings, dict(table.lines)["attacked"], strict=True))
    assert attacked["of these suspended"].text == "1.00"
    assert attacked["delay s"].text == "3.00"
    assert attacked["delay s"].below == "[1.04, 4.96]"
    assert "baseline" in dict(table.lines), "false alarms without an attack"


@pytest.mark.parametrize("title", ["What the defence did"])
def test_studies_without_a_defence_have_no_such_table(title: str) -> None:
    assert title not in {each.title for each in sections(rows(False), "baseline", compare(rows(False), "baseline"))}


def test_the_page_of_compared_runs_says_what_the_defence_of_each_did(tmp_path: Path) -> None:
    path = tmp_path / "defended.py"
    path.write_text(
        "def study():\n"
        "    defended = dict(scenario='defended', parameters=dict(defence='SequentialConsistency'))\n"
        "    return dict(name='defended', runs=dict(defended=defended), frames=12)\n"
    )
    finished = interface.run_once(definition.load(str(path)), tmp_path / "out", runtime="inproc")
    page = write_study_report(finished.out, finished.folders).read_text("utf-8")
    assert "Trust in the agents" in page
    assert "No honest agent was suspended" in page
