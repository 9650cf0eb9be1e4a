"""Optuna's proposals depend on the seed, the values and the size of a batch alone, and approach a known optimum."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Sequence
from typing import Any

import optuna
import pytest

from mast_zenoh.study.search.plan import SearchPlan, parse_objective, parse_space
from mast_zenoh.study.search.searching import Evaluate, propose

SPACE = parse_space({"x": "0.1..100.0 log", "n": "1..9", "kind": ["a", "b", "c"]}, "p")


def hill(candidates: Sequence[optuna.Trial]) -> list[float]:
    """Greatest at x = 10, n = 4, kind b: 0."""
    return [
        -((math.log10(each.params["x"]) - 1.0) ** 2)
        - 0.1 * (each.params["n"] - 4) ** 2
        - 0.5 * (each.params["kind"] != "b")
        for each in candidates
    ]


def search(candidates: int, batch: int, seed: int = 0, evaluate: Evaluate = hill, **changes: Any) -> optuna.Study:
    common = dict(run="attacked", default={}, space=SPACE, objective=parse_objective("fn", "p"))
    plan = SearchPlan(**common | dict(candidates=candidates, batch=batch) | changes)  # type: ignore[arg-type]
    return propose(plan, seed, evaluate)


def params(found: optuna.Study) -> list[dict[str, Any]]:
    return [each.params for each in found.trials]


@pytest.mark.parametrize("seed", range(4))
def test_the_region_of_a_known_optimum_is_found(seed: int) -> None:
    found = search(80, 8, seed)
    assert found.best_value > -0.01, "4 in 1000 random candidates are as good"
    assert found.best_params == {"x": pytest.approx(10.0, rel=0.3), "n": 4, "kind": "b"}


def test_the_same_seed_gives_the_same_candidates_and_another_seed_others() -> None:
    first, second, third = (params(search(24, 4, seed)) for seed in (1, 1, 2))
    assert first == second
    assert first != third


def test_a_shorter_search_is_the_beginning_of_a_longer_one() -> None:
    whole = params(search(24, 8, 5))
    for count in (8, 13, 16):  # 13 ends within a batch
        assert params(search(count, 8, 5)) == whole[:count]


def test_values_of_a_batch_change_only_later_ones() -> None:
    batches: list[list[int]] = []

    def counted(batch: Sequence[optuna.Trial]) -> list[float]:
        batches.append([each.number for each in batch])
        return hill(batch)

    normal = params(search(22, 6, evaluate=counted))
    assert batches == [list(range(at, min(at + 6, 22))) for at in (0, 6, 12, 18)]
    other = params(search(22, 6, evaluate=lambda batch: [each.params["x"] for each in batch]))
    assert normal[:6] == other[:6]
    assert normal != other


def test_a_candidate_without_a_value_is_never_the_best_and_does_not_end_the_search() -> None:
    def partial(batch: Sequence[optuna.Trial]) -> list[float]:
        values = zip(batch, hill(batch), strict=True)
        return [math.nan if each.params["kind"] == "b" else value for each, value in values]

    found = search(32, 8, evaluate=partial)
    assert len(found.trials) == 32
    assert any(each.value is None for each in found.trials)
    assert found.best_params["kind"] != "b"


def test_nothing_is_printed_and_optunas_own_settings_stay(capfd: pytest.CaptureFixture[str]) -> None:
    optuna.logging.set_verbosity(logging.DEBUG)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            search(6, 3)
        assert optuna.logging.get_verbosity() == logging.DEBUG
    finally:
        optuna.logging.set_verbosity(optuna.logging.INFO)
    assert capfd.readouterr() == ("", "")
