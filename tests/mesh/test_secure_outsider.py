"""An outsider gets at an open run in every way that physics allows, and at a secure one in none."""

from __future__ import annotations

from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.study.rogue import comparison

pytestmark = pytest.mark.mesh

#: Zenoh itself refuses a second session of an id that is there already, whatever the mesh.
NOWHERE = {"duplicate session id"}


@pytest.mark.parametrize("level", ["open", "acl"])
def test_the_outsider(tmp_path: Path, level: str) -> None:
    path, loaded = scenario.load("rogue")
    attempts = comparison.load("rogue")
    resolved = scenario.resolve(path, loaded)
    outcomes, stray = comparison.run_outsider(resolved, tmp_path / "run", level, attempts)
    assert outcomes.keys() == {attempt.name for attempt in attempts}
    succeeded = {name for name, outcome in outcomes.items() if outcome.succeeded}
    assert succeeded == (outcomes.keys() - NOWHERE if level == "open" else set()), outcomes
    assert stray == 0, "no message of a stranger that no attempt accounts for has reached a node"
    if level == "open":
        sent = [outcome for outcome in outcomes.values() if outcome.sent]
        assert len(sent) >= 5
        assert all(outcome.reached == outcome.expected for outcome in sent if not outcome.lured)
    else:
        admitted = {name for name, outcome in outcomes.items() if outcome.admitted}
        tried = {a.name for a in attempts if a.shows.startswith("infra_")} - NOWHERE
        assert admitted == tried, "who has a node's certificate is let in, and gets nothing by it"
        assert any(outcome.sent and not outcome.reached for outcome in outcomes.values())
