"""An invented agent is fused on an open mesh, and never where keys are protected."""

from __future__ import annotations

from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.study.outsider import comparison

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]


@pytest.mark.parametrize("level", ["open", "acl"])
def test_an_outsider_plays_an_absent_agent_on_an_open_mesh_only(tmp_path: Path, level: str) -> None:
    path, loaded = scenario.load("sybil")
    resolved = scenario.resolve(path, loaded)
    outcomes = dict(comparison.run_outsider(resolved, tmp_path / "run", level, comparison.load("sybil")))
    stray = outcomes.pop(comparison.STRAY).reached
    assert stray == 0
    unknown = outcomes.pop("agent that nobody knows")
    assert not unknown.succeeded, "no node subscribes to its key"
    assert len(outcomes) == 2
    for outcome in outcomes.values():
        if level == "open":
            assert outcome.reached == outcome.expected > 0
            assert outcome.heard >= outcome.sent // 2, "its tracks are in the broker's batches"
        else:
            assert not outcome.succeeded
    if level == "acl":
        stolen = outcomes["absent agent, another's key"]
        assert stolen.admitted
        assert stolen.sent > 0
