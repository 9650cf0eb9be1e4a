"""Checks in a scenario's file are applied; a failing one is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import mast_zenoh as mast
from mast_zenoh.checks import RunCheck
from mast_zenoh.checks.runs import apply

SCENARIO = """
from mast_zenoh.checks import RunCheck
from mast_zenoh.scenario import load


class Recorded(RunCheck):
    def check(self, folder):
        return (folder / "messages.mcap").is_file(), "looked for messages.mcap"


class Broken(RunCheck):
    def check(self, folder):
        raise KeyError("nosuch")


class Unfinished(RunCheck):
    pass


def scenario():
    return load("baseline", ["n_infrastructure=1"])[1]
"""


def test_checks_of_a_scenario_are_applied_and_a_failing_check_is_named(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(SCENARIO)
    run = mast.run(str(tmp_path / "mine.py"), frames=3, out=str(tmp_path / "run"))
    assert run.status == "ok"
    checks_by_name = {check["name"]: check for check in json.loads((run.path / "checks.json").read_text())["checks"]}
    assert checks_by_name["Recorded"]["ok"]
    assert not checks_by_name["Broken"]["ok"]
    assert "the check itself failed: KeyError" in checks_by_name["Broken"]["detail"]
    assert "mine.py:13" in checks_by_name["Broken"]["detail"]
    assert "Unfinished" not in checks_by_name


def test_a_run_without_faults_or_user_checks_is_not_checked(tmp_path: Path) -> None:
    run = mast.run("baseline", n_infrastructure=1, frames=3, out=str(tmp_path / "run"))
    assert not (run.path / "checks.json").exists()


@pytest.mark.parametrize(
    "returned", ["ok", (np.array([True, False]), "x"), (float("nan"), "x"), (1, "x"), (True, 5), None]
)
def test_a_check_fails_unless_it_returns_a_bool_and_a_sentence(tmp_path: Path, returned: object) -> None:
    class Odd(RunCheck):
        def check(self, folder: Path) -> tuple[bool, str]:
            return returned  # type: ignore[return-value]

    outcome = apply(Odd, tmp_path)
    assert not outcome.ok
    assert outcome.detail.startswith("the check itself failed: ")


def test_a_check_that_exits_fails(tmp_path: Path) -> None:
    class Leaver(RunCheck):
        def check(self, folder: Path) -> tuple[bool, str]:
            raise SystemExit(0)

    assert not apply(Leaver, tmp_path).ok
