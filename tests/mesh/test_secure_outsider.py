"""Every attempt of an outsider succeeds on an open run and fails otherwise."""

from __future__ import annotations

from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.study.outsider import comparison

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

#: On any mesh, Zenoh itself refuses a second session with an id already in use.
NOWHERE = {"duplicate session id"}


@pytest.mark.parametrize("level", ["open", "acl"])
def test_an_outsider_succeeds_in_an_open_run_and_fails_in_a_secure_one(tmp_path: Path, level: str) -> None:
    path, loaded = scenario.load("rogue")
    attempts = comparison.load("rogue")
    resolved = scenario.resolve(path, loaded)
    outcomes = dict(comparison.run_outsider(resolved, tmp_path / "run", level, attempts))
    stray = outcomes.pop(comparison.STRAY).reached
    assert outcomes.keys() == {attempt.name for attempt in attempts}
    succeeded = {name for name, outcome in outcomes.items() if outcome.succeeded}
    assert succeeded == (outcomes.keys() - NOWHERE if level == "open" else set()), outcomes
    assert stray == 0, "no foreign message beyond the attempts has reached a node"
    if level == "open":
        sent = [outcome for outcome in outcomes.values() if outcome.sent]
        assert len(sent) >= 5
        assert all(outcome.reached == outcome.expected for outcome in sent if not outcome.lured)
    else:
        admitted = {name for name, outcome in outcomes.items() if outcome.admitted}
        tried = {a.name for a in attempts if a.shows.startswith("infra_")} - NOWHERE
        assert admitted == tried, "a client with a node's certificate is admitted, but gains nothing"
        assert any(outcome.sent and not outcome.reached for outcome in outcomes.values())
