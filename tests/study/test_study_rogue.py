"""What an outsider is to try is checked before anything starts, and the table says what came of it."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.report import attempts_table
from mast_zenoh.report.attempts_table import STRAY, AttemptRow
from mast_zenoh.study import definition
from mast_zenoh.study.rogue import comparison
from mast_zenoh.study.rogue.attempts import Attempt, Outcome, RogueRouter

INJECT = "dict(type='Inject', name='a', wire='cc/picture')"


def listed(tmp_path: Path, *attempts: str) -> list[Attempt]:
    """The attempts of a scenario file that lists these."""
    file = tmp_path / "mine.py"
    file.write_text(f"def outsider():\n    return [{', '.join(attempts)}]\n")
    return comparison.load(str(file))


def test_our_outsider_tries_all_that_the_threat_model_names() -> None:
    attempts = {attempt.name: attempt for attempt in comparison.load("rogue")}
    assert {attempt.shows for attempt in attempts.values()} >= {"nothing", "foreign", "expired", "infra_1"}
    kinds = {type(attempt).__name__ for attempt in attempts.values()}
    assert kinds == {"Inject", "Eavesdrop", "AskRouter", "DuplicateSession", "RogueRouter"}
    assert [a.detours for a in attempts.values() if isinstance(a, RogueRouter)] == ["infra_2"]


@pytest.mark.parametrize(
    ("attempts", "said"),
    [
        ((INJECT, INJECT), "two attempts have the name 'a'"),
        ((INJECT, INJECT.replace("'a'", "'b'")), "two attempts have the key 'cc/picture'"),
        (("dict(type='Injekt')",), "'Inject'"),
        ((INJECT.replace("wire", "wires"),), "'wire'"),
    ],
)
def test_attempts_that_cannot_be_made_or_told_apart_are_refused(tmp_path: Path, attempts, said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        listed(tmp_path, *attempts)


def test_the_study_names_its_levels_and_refuses_others(tmp_path: Path) -> None:
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
def test_an_attempt_succeeds_when_anything_got_in_or_out_or_astray(outcome: Outcome, succeeded: bool) -> None:
    assert outcome.succeeded is succeeded


ROWS = [
    AttemptRow("rogue", "open", "inject", True, 20, 40, 40, 0, 0, True),
    AttemptRow("rogue", "open", "listen", True, heard=68, succeeded=True),
    AttemptRow("rogue", "open", STRAY),
    AttemptRow("rogue", "acl", "inject", True, 20, 0, 40),
    AttemptRow("rogue", "acl", "listen", True),
    AttemptRow("rogue", "acl", STRAY, reached=3, succeeded=True),
]


def test_the_table_has_a_line_for_each_attempt_and_a_column_for_each_level() -> None:
    lines = attempts_table.as_markdown(ROWS).splitlines()
    assert lines[0] == "| attempt | open | acl |"
    assert lines[2] == "| inject | succeeds (in 40/40) | refused (in 0/40) |"
    assert lines[3] == "| listen | succeeds (out 68) | refused (out 0) |"
    assert lines[4] == "| (anything else) | none (in 0) | succeeds (in 3) |"


def test_the_csv_has_every_count() -> None:
    rows = list(csv.DictReader(io.StringIO(attempts_table.as_csv(ROWS))))
    assert len(rows) == len(ROWS)
    assert rows[0] == dict(
        zip(AttemptRow._fields, ["rogue", "open", "inject", "1", "20", "40", "40", "0", "0", "1"], strict=True)
    )
