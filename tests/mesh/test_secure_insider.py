"""A compromised node can stop an open run, but not a secure one."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace

import pytest
from insider.forgeries import MALFORMED
from insider.infiltration import Finding, infiltrate, select_messages
from insider.position import position

from mast_zenoh import scenario
from mast_zenoh.control import CONTROLS
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
SOUND = Finding("ego", ["infra_1", "infra_10"], True, "", 10, 10, (), True, ())

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


@pytest.mark.parametrize("node", ["infra_1", "evaluator"])
def test_forged_controls_are_false_either_in_the_nodes_own_name_or_in_other_names(node: str) -> None:
    path, loaded = scenario.load("rogue")
    where = position(scenario.resolve(path, loaded, frames=1), node, "1.0")
    of_others = select_messages(where)
    own = select_messages(where, own=True)
    assert len(of_others) == len(own) == 120
    assert {each.control for each in of_others} == {*CONTROLS}
    assert all(each.defect == MALFORMED for each in of_others if each.sender == node)
    assert {each.sender for each in own} == {node}
    assert {each.control for each in own} == {"counts", "failed", "result", "fetch", "file"}


@pytest.mark.parametrize(
    ("finding", "verdict"),
    [
        (SOUND, "no effect"),
        (replace(SOUND, metrics=False), "succeeds: the run looks sound, but differs"),
        (replace(SOUND, changed=["clock"]), "succeeds: changed other nodes' messages (1 wires)"),
        (replace(SOUND, frames=4), "succeeds: stopped the run early, after 4 of 10 frames"),
        (replace(SOUND, failure="stall: ego has not reported"), "ends the run, and is named"),
        (replace(SOUND, failure="infra_10.start failed: ego"), "succeeds: ends the run, and infra_10 is named"),
        (replace(SOUND, failure="stopped", frames=1), "succeeds: ends the run, and no node is named"),
        (replace(SOUND, failure="ego: x", strays=["/tmp/x"]), "succeeds: wrote outside the run folder (/tmp/x)"),
        (replace(SOUND, ended=False), "succeeds: stalled the run"),
        (replace(SOUND, ended=False, crash="ValueError: x"), "succeeds: crashed the launcher (ValueError: x)"),
    ],
)
def test_verdict_on_an_insider_follows_from_the_finding(finding: Finding, verdict: str) -> None:
    assert finding.verdict == verdict
    assert finding.succeeded == verdict.startswith("succeeds")
