"""A compromised node can stop an open run, but not a secure one."""

import os
from collections.abc import Callable

import pytest
from insider.infiltration import Finding, infiltrate

from mast_zenoh import scenario
from mast_zenoh.launch import run

#: One compromised node of each role except the simulator, by role.
INSIDERS = {
    "link": "link_ego",
    "agent": "infra_1",
    "broker": "broker",
    "command_center": "command_center",
    "adversary": "adversary_1",
    "coordinator": "coordinator",
    "evaluator": "evaluator",
    "recorder": "recorder",
}
ALL = int(os.environ.get("MAST_FORGERIES", "4")) >= 200

Infiltration = Callable[..., tuple[bool, int, Finding]]


@pytest.fixture(scope="module")
def infiltrated(tmp_path_factory: pytest.TempPathFactory) -> Infiltration:
    """Plays the run of scenarios/rogue.py with a compromised node, next to an undisturbed twin."""
    path, loaded = scenario.load("rogue")
    recorded = loaded | {"run": {"mode": "lockstep", "record": True}}
    resolved = scenario.resolve(path, recorded, frames=60, record=True)
    assert {resolved.nodes[node].role for node in INSIDERS.values()} == {
        spec.role for spec in resolved.nodes.values()
    } - {"simulator"}
    twin = run.run(resolved, tmp_path_factory.mktemp("twin") / "run", runtime="inproc")
    assert twin.error is None

    def play(level: str, node: str, own: bool = False) -> tuple[bool, int, Finding]:
        return infiltrate(resolved, tmp_path_factory.mktemp(level) / "run", level, node, twin.folder, own=own)

    return play


@pytest.mark.heavy
@pytest.mark.mesh
@pytest.mark.parametrize("role", INSIDERS if ALL else ["link"])
def test_forged_reports_of_an_insider_stop_an_open_run_but_no_secure_one(infiltrated: Infiltration, role: str) -> None:
    admitted, sent, finding = infiltrated("acl", INSIDERS[role])
    assert (admitted, sent, finding.verdict) == (True, 120, "no effect")
    admitted, sent, finding = infiltrated("open", INSIDERS[role])
    assert admitted
    assert finding.succeeded, finding


@pytest.mark.heavy
@pytest.mark.mesh
@pytest.mark.skipif(not ALL, reason="make insiders")
@pytest.mark.parametrize("level", ["tls", "mtls"])
@pytest.mark.parametrize("role", INSIDERS)
def test_certificates_alone_stop_no_insider(infiltrated: Infiltration, role: str, level: str) -> None:
    assert infiltrated(level, INSIDERS[role])[2].succeeded


@pytest.mark.heavy
@pytest.mark.mesh
@pytest.mark.skipif(not ALL, reason="make insiders")
def test_lies_of_an_insider_about_itself_end_the_run_and_name_it(infiltrated: Infiltration) -> None:
    assert infiltrated("acl", "infra_1", own=True)[2].verdict == "ends the run, and is named"
