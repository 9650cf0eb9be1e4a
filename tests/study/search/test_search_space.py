"""Ranges and objectives are read; invalid ones are refused with the nearest valid choice."""

from __future__ import annotations

import math
from typing import Any

import pytest
import synthetic_outcomes
from hypothesis import given
from hypothesis import strategies as st
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.metrics.study_results import StudySeries
from mast_zenoh.study import numbers
from mast_zenoh.study.search.plan import as_text, parse_objective, parse_space, with_values


def test_a_space_is_a_dict_or_the_same_as_text() -> None:
    as_dict = parse_space({"budget": "0.5..4.0 log", "n_adversaries": "1..3", "knowledge": ["own", "trust"]}, "p")
    as_text = parse_space("budget=0.5..4.0 log; n_adversaries = 1..3; knowledge=own|trust", "p")
    assert as_dict == as_text
    assert as_dict["budget"] == FloatDistribution(0.5, 4.0, log=True)
    assert as_dict["n_adversaries"] == IntDistribution(1, 3)
    assert as_dict["knowledge"] == CategoricalDistribution(("own", "trust"))


def test_choices_as_text_are_numbers_if_they_are_written_as_numbers() -> None:
    assert parse_space("k=1|2.5|three|-1e-3", "p") == {"k": CategoricalDistribution((1, 2.5, "three", -1e-3))}


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.booleans())
def test_a_range_reads_as_it_is_written(first: float, second: float, log: bool) -> None:
    low, high = sorted((first, second))
    log &= low > 0.0
    if low == high:
        return
    written = FloatDistribution(low, high, log)
    assert parse_space({"x": as_text(written)}, "p") == {"x": written}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, r"p: found \{\}, expected a dict"),
        (3, "p: found 3, expected a dict"),
        ("", "expected a dict: name of a parameter to its range"),
        ({"x": 3}, r"p\.x: found 3, expected 'LOW\.\.HIGH'"),
        ({"x": "1-3"}, r"p\.x: found '1-3', expected 'LOW\.\.HIGH'"),
        ({"x": "3..1"}, "found '3..1', expected a finite low end below the high end"),
        ({"x": "1..1"}, "expected a finite low end below the high end"),
        ({"x": "1.0..1e999"}, "expected a finite low end below the high end"),
        ({"x": "0.0..1.0 log"}, "expected a low end above 0 for a logarithmic range"),
        ({"x": "0.1..1.0 lin"}, r"expected 'LOW\.\.HIGH', 'LOW\.\.HIGH log'"),
        ({"x": ["a"]}, "expected at least two choices, each once"),
        ({"x": ["a", "a"]}, "expected at least two choices, each once"),
        ({"x": [True, 1]}, "expected at least two choices, each once"),  # Optuna takes equal ones for one
        ({"x": ["1", 1]}, "expected at least two choices, each once"),  # the same setting
        ({"": "1..2"}, "found the name ''"),
        ({"a..b": "1..2"}, "found the name 'a..b'"),
        ({3: "1..2"}, "found the name 3"),
        ("x", "found 'x', expected NAME=LOW..HIGH"),
        ("x=1..2; x=1..3", r"p\.x: found twice"),
    ],
)
def test_invalid_spaces_are_refused_by_name(content: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        parse_space(content, "p")


def test_a_dotted_name_reaches_into_a_parameter_that_is_a_dict_and_leaves_the_original_alone() -> None:
    default = {"attack": {"type": "Mimic"}, "n_adversaries": 1}
    values = {"attack.budget": 3.0, "n_adversaries": 2, "command_center.pipeline.x": 1}
    changed = with_values(default, values, "p")
    assert changed == {
        "attack": {"type": "Mimic", "budget": 3.0},
        "n_adversaries": 2,
        "command_center.pipeline.x": 1,
    }
    assert default == {"attack": {"type": "Mimic"}, "n_adversaries": 1}


def test_an_entry_of_a_chosen_dict_is_set_in_the_one_that_was_chosen() -> None:
    values = {"attack.imitation.type": "Exact", "attack": {"type": "B"}}
    assert with_values({"attack": "A"}, values, "p") == {"attack": {"type": "B", "imitation": {"type": "Exact"}}}


def test_an_entry_of_a_parameter_that_is_no_dict_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"p\.attack\.budget: attack is 'Mimic', expected a dict"):
        with_values({"attack": "Mimic"}, {"attack.budget": 1.0}, "p")


def test_an_objective_names_metric_estimator_and_owner() -> None:
    assert parse_objective("fn", "p").terms == (StudySeries("", "picture", "fn"),)
    assert parse_objective("mission/fn", "p").terms == (StudySeries("", "mission", "fn"),)
    assert parse_objective("infra_1/local/fn", "p").terms == (StudySeries("infra_1", "local", "fn"),)
    assert parse_objective("defence/false_alarms", "p").terms == (StudySeries("all", "defence", "false_alarms"),)
    assert parse_objective("fn+ fp", "p").text == "fn + fp"


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("fn + fp", "missed objects + false objects per frame, picture"),
        ("mission/fp_iob", "false objects added per frame, ego with picture"),
        ("id_switches", "identity switches per run, picture"),
        ("rmse_m", "RMSE (m), picture"),
        ("fn + mission/fn", "missed objects (picture) + missed objects (ego with picture) per frame"),
        ("infra_1/local/fn", "missed objects per frame, infra_1: ego alone"),
        ("defence/false_alarms", "false alarms, defence"),
    ],
)
def test_an_objective_has_words_and_a_unit(text: str, label: str) -> None:
    assert parse_objective(text, "p").label == label


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "found None, expected a metric such as 'fn"),
        ("", "expected a metric"),
        ("fn +", "expected a metric"),
        ("a/b/c/d", "expected METRIC, ESTIMATOR/METRIC or WHO/ESTIMATOR/METRIC"),
        ("picture/", "expected METRIC, ESTIMATOR/METRIC"),
        ("fn + fn", "expected each number once"),
        ("mission/driving.min_ttc_s", "has no mean: expected 'driving.critical'"),
        ("driven/min_ttc_s", "has no mean: expected 'driven/near_misses'"),
    ],
)
def test_invalid_objectives_are_refused(text: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        parse_objective(text, "search.objective")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("fpp", "no metric 'fpp' of 'ego', 'picture'; did you mean 'fp'"),
        ("mision/fp", "no estimator 'mision' of 'ego'; did you mean 'mission'"),
        ("infra/local/fp", "no numbers of 'infra' in the runs; known: ego"),
        ("defence/false_alarms", "no numbers of 'all' in the runs"),
    ],
)
def test_numbers_that_runs_do_not_have_are_refused_with_the_nearest_one(text: str, message: str) -> None:
    known = list(numbers.numbers(synthetic_outcomes.outcome("attacked", 0, 0).metrics))
    with pytest.raises(ConfigurationError, match=message):
        parse_objective(text, "p").check(known, "ego", "p")
    parse_objective("fp + mission/rmse_m", "p").check(known, "ego", "p")


def test_a_value_is_the_sum_of_its_numbers_and_unknown_if_one_is() -> None:
    outcome = synthetic_outcomes.outcome("attacked", 0, 0, fp=3.0)
    known = list(numbers.numbers(outcome.metrics))
    assert parse_objective("fn + fp", "p").value(known, "ego") == 5.0
    assert math.isnan(parse_objective("fn + fp_iob", "p").value(known, "ego"))
