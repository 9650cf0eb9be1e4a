"""Attackers are validated before a study starts; the table shows their effects."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh import scenario
from mast_zenoh.config import loading
from mast_zenoh.control import CONTROLS
from mast_zenoh.errors import ConfigurationError, HandlerFailed, Interrupted
from mast_zenoh.report.tables import attempts as attempts_table
from mast_zenoh.report.tables.attempts import STRAY, AttemptRow
from mast_zenoh.study import definition
from mast_zenoh.study.rogue import comparison
from mast_zenoh.study.rogue.attacked_run import attacker_errors
from mast_zenoh.study.rogue.attempts import Attempt, Outcome, RogueRouter
from mast_zenoh.study.rogue.forgeries import MALFORMED
from mast_zenoh.study.rogue.infiltration import Finding
from mast_zenoh.study.rogue.insiders import ForgeControls
from mast_zenoh.study.rogue.position import position

BASELINE = "loading.function('scenarios', 'baseline', 'scenario')"
INJECT = "dict(type='Inject', name='a', wire='cc/picture')"


def listed(tmp_path: Path, *attempts: str) -> list[Attempt]:
    """Load the attempts of a scenario file that lists these."""
    file = tmp_path / "mine.py"
    file.write_text(f"def scenario():\n    return {{}}\ndef outsider():\n    return [{', '.join(attempts)}]\n")
    return comparison.load(str(file))


def test_shipped_outsider_makes_every_attempt_of_the_threat_model() -> None:
    attempts = {attempt.name: attempt for attempt in comparison.load("rogue")}
    assert {attempt.shows for attempt in attempts.values()} >= {"nothing", "foreign", "expired", "infra_1"}
    kinds = {type(attempt).__name__ for attempt in attempts.values()}
    assert kinds == {"Inject", "Eavesdrop", "AskRouter", "DuplicateSession", "RogueRouter"}
    assert [a.detour_node for a in attempts.values() if isinstance(a, RogueRouter)] == ["infra_2"]


def test_shipped_insiders_cover_every_role_except_the_driver() -> None:
    path, loaded = scenario.load("rogue")
    nodes = scenario.resolve(path, loaded | {"run": {"record": True}}, frames=1, record=True).nodes
    insiders = comparison.load_insiders("rogue")
    assert {nodes[insider.node].role for insider in insiders} == {spec.role for spec in nodes.values()} - {"simulator"}


def test_scenario_file_may_define_insiders_and_no_outsider(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        "from mast_zenoh.study.rogue.insiders import Insider\n"
        "class Mute(Insider):\n"
        "    def act(self, attacked_run, session, position):\n"
        "        return 0\n"
        "def scenario():\n    return {}\n"
        "def insiders():\n    return [dict(type='Mute', name='mute', node='ego')]\n"
    )
    assert comparison.load(str(file)) == []
    assert [(insider.name, insider.node) for insider in comparison.load_insiders(str(file))] == [("mute", "ego")]


@pytest.mark.parametrize(
    ("listed", "message"),
    [
        ("", "lists no attackers: expected a function `outsider` or `insiders`"),
        ("def insiders():\n    return [dict(type='ForgeControls', name='a', node='infra_9')]", "no node 'infra_9'"),
        ("def insiders():\n    return 7", "returned int, expected a list of dicts"),
        ("def insiders():\n    return 2 * [dict(type='ForgeControls', name='a', node='ego')]", "the name 'a'"),
    ],
)
def test_study_without_attackers_or_with_invalid_ones_is_rejected(tmp_path: Path, listed: str, message: str) -> None:
    (tmp_path / "mine.py").write_text(f"from mast_zenoh.config import loading\n_, scenario = {BASELINE}\n{listed}\n")
    content = f"dict(name='s', runs=dict(a=dict(scenario={str(tmp_path / 'mine.py')!r})), security=['acl'])"
    (tmp_path / "s.py").write_text(f"def study():\n    return {content}\n")
    with pytest.raises(ConfigurationError, match=message):
        comparison.run(definition.load(str(tmp_path / "s.py")), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("node", ["infra_1", "evaluator"])
def test_forged_controls_are_false_either_in_the_nodes_own_name_or_in_other_names(
    node: str,
) -> None:
    path, loaded = scenario.load("rogue")
    where = position(scenario.resolve(path, loaded, frames=1), node, "1.0")
    of_others = ForgeControls("a", node).select_messages(where)
    own = ForgeControls("a", node, own=True).select_messages(where)
    assert len(of_others) == len(own) == 30
    assert {each.control for each in of_others} == {*CONTROLS}
    assert all(each.defect == MALFORMED for each in of_others if each.sender == node)
    assert {each.sender for each in own} == {node}
    assert {each.control for each in own} == {"counts", "failed", "result", "fetch", "file"}


SOUND = Finding("ego", ["infra_1", "infra_10"], True, "", 10, 10, (), True, ())


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


@pytest.mark.parametrize(
    ("attempts", "message"),
    [
        ((INJECT, INJECT), "two attempts have the name 'a'"),
        ((INJECT, INJECT.replace("'a'", "'b'")), "two attempts have the key 'cc/picture'"),
        (("dict(type='Injekt')",), "'Inject'"),
        ((INJECT.replace("wire", "wires"),), "'wire'"),
    ],
)
def test_invalid_or_ambiguous_attempts_are_rejected(tmp_path: Path, attempts, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        listed(tmp_path, *attempts)


def test_interrupted_study_keeps_its_rows_and_status(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def outside(each: Any, level: str, folder: Path) -> list[AttemptRow]:
        if level != "open":
            raise KeyboardInterrupt
        assert json.loads((folder / "study.json").read_text())["status"] == "running"
        return [ROWS[0]]

    monkeypatch.setattr(comparison, "_outsider_rows", outside)
    with pytest.raises(Interrupted, match=r"results so far are in .*study\.json"):
        comparison.run(definition.load("rogue"), tmp_path / "out")
    written = json.loads((tmp_path / "out" / "study.json").read_text())
    assert written["status"] == "interrupted"
    assert written["rows"] == [ROWS[0]._asdict()]


def test_error_in_an_attackers_code_names_file_and_line(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("def act():\n    return 1 / 0\n")
    act = loading.module(file).act
    named = r"the attacker 'a' failed: ZeroDivisionError.*mine\.py:2"
    with pytest.raises(HandlerFailed, match=named), attacker_errors("a", act):
        act()


def test_study_levels_are_validated(tmp_path: Path) -> None:
    assert definition.load("rogue").security == ("open", "tls", "mtls", "acl")
    with pytest.raises(ConfigurationError, match="'mtls'"):
        definition.load("rogue", ["levels=open,mtsl"])
    assert definition.load("case_study").security == ()


@pytest.mark.parametrize(
    ("outcome", "succeeded"),
    [
        (Outcome(), False),
        (Outcome(admitted=True, sent=20, expected=20), False),
        (Outcome(reached=1), True),
        (Outcome(heard=1), True),
        (Outcome(lured=1), True),
    ],
)
def test_attempt_succeeds_if_any_message_was_injected_overheard_or_diverted(outcome: Outcome, succeeded: bool) -> None:
    assert outcome.succeeded is succeeded


ROWS = [
    AttemptRow("rogue", "open", "inject", True, 20, 40, 40, 0, 0, True),
    AttemptRow("rogue", "open", "listen", True, heard=68, succeeded=True),
    AttemptRow("rogue", "open", STRAY),
    AttemptRow("rogue", "acl", "inject", True, 20, 0, 40),
    AttemptRow("rogue", "acl", "listen", True),
    AttemptRow("rogue", "acl", STRAY, reached=3, succeeded=True),
    AttemptRow("rogue", "open", "agent", True, 30, succeeded=True, verdict="succeeds: stopped the run early"),
    AttemptRow("rogue", "acl", "agent", True, 30, verdict="no effect"),
]


def test_table_has_a_line_per_attempt_and_a_column_per_level() -> None:
    lines = attempts_table.as_markdown(ROWS).splitlines()
    assert lines[0] == "| attempt | open | acl |"
    assert lines[2] == "| inject | succeeds (in 40/40) | no effect (in 0/40) |"
    assert lines[3] == "| listen | succeeds (out 68) | no effect (out 0) |"
    assert lines[4] == "| (anything else) | none (in 0) | succeeds (in 3) |"
    assert lines[5] == "| agent | succeeds: stopped the run early (sent 30) | no effect (sent 30) |"


def test_csv_has_every_count() -> None:
    rows = list(csv.DictReader(io.StringIO(attempts_table.as_csv(ROWS))))
    assert len(rows) == len(ROWS)
    assert rows[0] == dict(
        zip(AttemptRow._fields, ["rogue", "open", "inject", "1", "20", "40", "40", "0", "0", "1", ""], strict=True)
    )
