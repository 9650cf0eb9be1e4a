"""A compromised node can stop an open run, but not a secure one."""

from __future__ import annotations

from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.launch import run
from mast_zenoh.study.rogue.infiltration import infiltrate
from mast_zenoh.study.rogue.insiders import ForgeControls

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]


def test_forged_reports_of_an_insider_stop_an_open_run_but_no_secure_one(tmp_path: Path) -> None:
    path, loaded = scenario.load("rogue")
    recorded = loaded | {"run": {"mode": "lockstep", "record": True}}
    resolved = scenario.resolve(path, recorded, frames=60, record=True)
    twin = run.run(resolved, tmp_path / "twin", runtime="inproc")
    assert twin.error is None
    insider = ForgeControls("link", "link_ego")
    admitted, sent, findings = infiltrate(resolved, tmp_path / "acl", "acl", insider, twin.folder)
    assert (admitted, sent, findings.verdict) == (True, 30, "no effect")
    admitted, sent, findings = infiltrate(resolved, tmp_path / "open", "open", insider, twin.folder)
    assert admitted
    assert findings.succeeded, findings
