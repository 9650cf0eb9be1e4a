"""Every attempt of an outsider succeeds on an open run and fails otherwise."""

from pathlib import Path

import pytest

from mast_zenoh import scenario
from mast_zenoh.study import attacked_run, definition

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

#: On any mesh, Zenoh itself refuses a second session with an id already in use.
NOWHERE = {"duplicate session id"}


Outcomes = dict[str, attacked_run.Outcome]


def outcomes_of(folder: Path, name: str, level: str) -> Outcomes:
    """What each attempt on a run of a scenario achieved; no foreign message beyond the attempts may reach a node."""
    resolved = scenario.resolve(*scenario.load(name))
    outcomes = attacked_run.attack(resolved, folder / "run", level, definition.load(name).attempts)
    assert outcomes.pop(attacked_run.STRAY).reached == 0
    return outcomes


@pytest.mark.parametrize("level", ["open", "acl"])
def test_an_outsider_succeeds_in_an_open_run_and_fails_in_a_secure_one(tmp_path: Path, level: str) -> None:
    attempts = definition.load("rogue").attempts
    outcomes = outcomes_of(tmp_path, "rogue", level)
    assert outcomes.keys() == {attempt.name for attempt in attempts}
    succeeded = {name for name, outcome in outcomes.items() if outcome.succeeded}
    assert succeeded == (outcomes.keys() - NOWHERE if level == "open" else set()), outcomes
    if level == "open":
        sent = [outcome for outcome in outcomes.values() if outcome.sent]
        assert len(sent) >= 5
        assert all(outcome.reached == outcome.expected for outcome in sent if not outcome.lured)
    else:
        admitted = {name for name, outcome in outcomes.items() if outcome.admitted}
        tried = {a.name for a in attempts if a.shows.startswith("infra_")} - NOWHERE
        assert admitted == tried, "a client with a node's certificate is admitted, but gains nothing"
        assert any(outcome.sent and not outcome.reached for outcome in outcomes.values())


@pytest.mark.parametrize("level", ["open", "acl"])
def test_an_outsider_plays_an_absent_agent_on_an_open_mesh_only(tmp_path: Path, level: str) -> None:
    outcomes = outcomes_of(tmp_path, "sybil", level)
    assert not outcomes.pop("agent that nobody knows").succeeded, "no node subscribes to its key"
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
