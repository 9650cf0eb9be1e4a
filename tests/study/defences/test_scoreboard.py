"""The scoreboard of `mast study matrix`: ranking, worst cases, significance and conclusions, from synthetic trials."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from typing import Any

import pytest
from test_field_matrix import MANY, POLES, cell, collected, ghosts, trial

from mast_zenoh.study.defences.matrix_table import MatrixTable
from mast_zenoh.study.defences.matrix_tables import matrix_tables
from mast_zenoh.study.defences.scoreboard import Scoreboard, scoreboard_tables

SCENES = (POLES, MANY)
#: Errors of each seed around the mean.
NOISE = (-0.3, 0.1, 0.3, -0.1, 0.2, -0.2)


def table_of(
    errors: Mapping[str, Mapping[str, tuple[float, float]]], silent: tuple[str, str] = ("", ""), seeds: int = 6
) -> MatrixTable:
    """A matrix; errors: false objects by defence and attack ("": none), in the scene with poles and in that with all.

    silent: defence and attack in which the adversaries never lie
    """
    played: dict[Any, Any] = {}
    for number, (defence, attacks) in enumerate(errors.items()):
        for attack, means in attacks.items():

            def content(scene: str, seed: int, number: int = number, means: Any = means, **how: Any) -> dict[str, Any]:
                noise = NOISE[(seed + 2 * number) % len(NOISE)] if how["liars"] else 0.0
                return trial(means[SCENES.index(scene)] + noise, **how)

            how: dict[str, Any] = dict(liars=2 if attack else 0, silent=(defence, attack) == silent)
            chosen = ghosts(defence, attack=attack) if attack else cell(defence)
            played[chosen] = lambda scene, seed, content=content, how=how: content(scene, seed, **how)
    return collected(played, SCENES, range(seeds))


#: KOfN's worst case is worse than that of no defence, with another attack. Robosac is worse without an attack, too.
ERRORS = {
    "NoIntegrity": {"": (1.0, 2.0), "Ghost": (7.0, 4.0), "Flood": (11.0, 6.0)},
    "Robosac": {"": (9.0, 8.0), "Ghost": (21.0, 8.0), "Flood": (10.0, 8.0)},
    "KOfN": {"": (1.0, 2.0), "Ghost": (11.5, 4.0), "Flood": (3.0, 3.0)},
    "Cad": {"": (0.0, 1.0), "Ghost": (2.0, 4.5), "Flood": (3.0, 3.0)},
}


def test_defences_are_ranked_by_their_worst_case_over_attacks_and_kinds_of_scene() -> None:
    scores = Scoreboard(table_of(ERRORS)).scores
    assert [score.worst.of["defence"] for score in scores] == ["Cad", "NoIntegrity", "KOfN", "Robosac"]
    cases = [(score.worst.of["attack"], score.worst.of["scene"]) for score in scores]
    assert cases == [("Ghost", "8 poles, 4 cars"), ("Flood", "4 poles"), ("Ghost", "4 poles"), ("Ghost", "4 poles")]
    best = scores[0].worst
    values = best["damage"].value, best["by_attack"].value, best["harm"].value
    assert values == pytest.approx((4.5 - 2.0, 4.5 - 1.0, 4.5 - 4.0), abs=1e-9)
    assert [score.quiet["damage"].value for score in scores] == pytest.approx([-1.0, 0.0, 0.0, 8.0])


def test_five_sentences_say_what_the_table_does() -> None:
    tables = scoreboard_tables(table_of(ERRORS))
    (table,) = tables.tables
    first, rivals, beaten, gain, cost = tables.reading
    assert table.lines[0][1] == "Ghost (2 of 8 poles, 4 cars, random)"
    assert table.lines[0][2] in first
    assert first.startswith(
        "Cad has the best worst case of 3 defences: with Ghost (2 of 8 poles, 4 cars, random), 2.50 ["
    )
    assert f"no attack and no defence, of which the attack adds {table.lines[0][3]}." in first
    assert rivals == "No other row's interval overlaps with its own."
    assert beaten.startswith("What beats defences most is Ghost (3 of 3); without a defence, Flood (2 of 4 poles, ")
    assert gain.startswith("In its worst case, better than no defence: none; worse: KOfN and Robosac;")
    assert cost.startswith("Without an attack, clearly more errors than without a defence: none; fewer: none;")
    assert cost.endswith("the greatest cost is that of Robosac: 8.00 (all equal) a frame.")
    gaining = scoreboard_tables(table_of({name: ERRORS[name] for name in ("NoIntegrity", "Cad")})).reading[-1]
    assert gaining.endswith("the smallest gain is that of Cad: \u22121.00 (all equal) a frame.")
    assert all(f"\n{at}. {text}" in tables.as_markdown() for at, text in enumerate(tables.reading, 1))


def test_a_row_whose_interval_overlaps_with_that_of_the_best_is_not_told_apart_from_it() -> None:
    close = ERRORS | {"Cad": {"": (1.0, 2.0), "Ghost": (10.9, 4.0), "Flood": (3.0, 3.0)}}
    rivals = scoreboard_tables(table_of(close)).reading[1]
    assert rivals == "Not told apart from it, as intervals overlap or are missing: NoIntegrity."


def test_two_seeds_have_no_interval_and_decide_nothing() -> None:
    tables = scoreboard_tables(table_of(ERRORS, seeds=2))
    assert "*" not in "".join(cell for line in tables.tables[0].lines for cell in line)
    assert tables.reading[1] == "That number has no interval, so the order of the rows is open."
    assert "better than no defence: none; worse: none; for all others" in tables.reading[3]
    assert "No number can be tested: there are fewer than 5 seeds" in tables.tables[0].about
    assert "Holm" not in tables.tables[0].about
    assert {line[-1] for line in tables.tables[0].lines} == {"2"}


def test_an_attack_in_which_nobody_lied_is_no_worst_case() -> None:
    scores = Scoreboard(table_of(ERRORS, silent=("Robosac", "Ghost"))).scores
    (robosac,) = (score for score in scores if score.worst.of["defence"] == "Robosac")
    assert (robosac.worst.of["attack"], robosac.worst.of["scene"]) == ("Flood", "4 poles")


def test_a_defence_that_does_more_harm_than_any_attack_is_beaten_by_its_own_cost() -> None:
    costly = ERRORS | {"Robosac": {"": (30.0, 8.0), "Ghost": (21.0, 8.0), "Flood": (10.0, 8.0)}}
    tables = scoreboard_tables(table_of(costly))
    assert tables.tables[0].lines[-1][:2] == ["Robosac", "no attack (4 poles)"]


def test_where_no_defence_has_a_better_worst_case_than_none_the_first_sentence_says_so() -> None:
    useless = {name: errors for name, errors in ERRORS.items() if name != "Cad"}
    first = scoreboard_tables(table_of(useless)).reading[0]
    assert first.startswith(
        "No defence at all has the best worst case of 2 defences: with Flood (2 of 4 poles, random)"
    )


def test_marks_are_adjusted_for_every_case_that_a_score_is_chosen_from() -> None:
    whole = table_of(ERRORS)
    board = Scoreboard(whole)
    plain = {tuple(row.of.values()): row for row in whole.by_scene}
    tested = [(row, name) for row in board.rows for name, each in row.numbers.items() if not math.isnan(each.p)]
    assert len(tested) == board.tests
    assert all(row.of["attack"] for row, _ in tested), "equal values, as of runs without an attack, have no test"
    damages = [row for row, name in tested if name == "damage"]
    assert len(damages) == 2 * 2 * len(ERRORS), "of two attacks in two kinds of scene"
    for row, name in tested:
        assert row[name].p >= plain[tuple(row.of.values())][name].p
    rows = list(csv.DictReader(io.StringIO(scoreboard_tables(whole).as_csv())))
    assert len(rows) == 3 * 3 * 2 * len(ERRORS)
    assert {(row["defence"], row["attack"]) for row in rows if row["worst"] == "1"} >= {("Cad", "Ghost")}
    assert min(float(row["p"]) for row in rows if row["p"]) == min(row[name].p for row, name in tested)


def test_without_adversaries_or_defences_there_is_no_scoreboard() -> None:
    alone = table_of({name: {"": errors[""]} for name, errors in ERRORS.items()})
    undefended = table_of({"NoIntegrity": ERRORS["NoIntegrity"]})
    for table in (alone, undefended):
        tables = scoreboard_tables(table)
        assert (tables.tables, tables.reading) == ([], [])
        assert tables.as_markdown().startswith("# Scoreboard")


def test_the_page_and_the_terminal_begin_with_the_scoreboard() -> None:
    tables = matrix_tables(table_of(ERRORS))
    assert tables.tables[0].title == tables.brief[0].title == "Scoreboard"
    assert len(tables.reading) == 5
    assert all(text in tables.brief[0].about for text in tables.reading)
