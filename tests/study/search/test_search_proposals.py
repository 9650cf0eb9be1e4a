"""Optuna's proposals depend on the seed, the values and the size of a batch alone, and approach a known optimum."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Sequence

import pytest

from mast_zenoh.study.search.proposals import Candidate, Effort, best_of, search
from mast_zenoh.study.search.space import parse_space

pytest.importorskip("optuna", reason="Optuna is not installed")

SPACE = parse_space({"x": "0.1..100.0 log", "n": "1..9", "kind": ["a", "b", "c"]}, "p")


def hill(candidates: Sequence[Candidate]) -> list[float]:
    """Greatest at x = 10, n = 4, kind b: 0."""
    return [
        -((math.log10(each.values["x"]) - 1.0) ** 2)
        - 0.1 * (each.values["n"] - 4) ** 2
        - 0.5 * (each.values["kind"] != "b")
        for each in candidates
    ]


@pytest.mark.parametrize("seed", range(4))
def test_the_region_of_a_known_optimum_is_found(seed: int) -> None:
    best = best_of(search(SPACE, Effort(80, 8, seed), hill), maximise=True)
    assert best is not None
    assert best.value > -0.01, "4 in 1000 random candidates are as good"
    assert best.values == {"x": pytest.approx(10.0, rel=0.3), "n": 4, "kind": "b"}


def test_later_candidates_are_better_than_random_ones() -> None:
    def late(sampler: str) -> float:
        values = [each.value for seed in range(4) for each in search(SPACE, Effort(80, 8, seed, sampler), hill)[40:]]
        return sum(values) / len(values)

    assert late("TPE") > late("random") + 1.0


def test_minimising_is_maximising_the_negative() -> None:
    up = search(SPACE, Effort(24, 4, 0), hill)
    down = search(SPACE, Effort(24, 4, 0, maximise=False), lambda batch: [-value for value in hill(batch)])
    assert [each.values for each in up] == [each.values for each in down]
    assert best_of(up, maximise=True).number == best_of(down, maximise=False).number  # type: ignore[union-attr]


def test_the_same_seed_gives_the_same_candidates_and_another_seed_others() -> None:
    first, second, third = (search(SPACE, Effort(24, 4, seed), hill) for seed in (1, 1, 2))
    assert first == second
    assert [each.values for each in first] != [each.values for each in third]


def test_a_shorter_search_is_the_beginning_of_a_longer_one() -> None:
    whole = search(SPACE, Effort(24, 8, 5), hill)
    for count in (8, 13, 16):  # 13 ends within a batch
        assert search(SPACE, Effort(count, 8, 5), hill) == whole[:count]


def test_candidates_come_in_batches_and_values_of_a_batch_change_only_later_ones() -> None:
    sizes: list[int] = []

    def counted(batch: Sequence[Candidate]) -> list[float]:
        sizes.append(len(batch))
        return hill(batch)

    normal = search(SPACE, Effort(22, 6, 0), counted)
    assert sizes == [6, 6, 6, 4]
    assert [each.batch for each in normal] == [0] * 6 + [1] * 6 + [2] * 6 + [3] * 4
    assert [each.number for each in normal] == list(range(22))
    other = search(SPACE, Effort(22, 6, 0), lambda batch: [each.values["x"] for each in batch])
    assert [each.values for each in normal[:6]] == [each.values for each in other[:6]]
    assert [each.values for each in normal] != [each.values for each in other]


def test_a_candidate_without_a_value_is_never_the_best_and_does_not_end_the_search() -> None:
    def partial(batch: Sequence[Candidate]) -> list[float]:
        values = zip(batch, hill(batch), strict=True)
        return [math.nan if each.values["kind"] == "b" else value for each, value in values]

    done = search(SPACE, Effort(32, 8, 0), partial)
    assert len(done) == 32
    assert any(math.isnan(each.value) for each in done)
    assert best_of(done, maximise=True).values["kind"] != "b"  # type: ignore[union-attr]


def test_without_any_value_there_is_no_best() -> None:
    done = search(SPACE, Effort(6, 3, 0), lambda batch: [math.nan] * len(batch))
    assert best_of(done, maximise=True) is None


def test_of_equal_candidates_the_first_is_the_best() -> None:
    done = search(SPACE, Effort(9, 3, 0), lambda batch: [1.0] * len(batch))
    assert best_of(done, maximise=True).number == best_of(done, maximise=False).number == 0  # type: ignore[union-attr]


def test_all_values_are_within_their_ranges() -> None:
    for each in search(SPACE, Effort(40, 8, 0, "random"), hill):
        assert 0.1 <= each.values["x"] <= 100.0
        assert each.values["n"] in range(1, 10)
        assert type(each.values["n"]) is int
        assert each.values["kind"] in ("a", "b", "c")


def test_a_choice_may_be_a_dict() -> None:
    space = parse_space({"attack": [{"type": "A"}, {"type": "B"}]}, "p")
    done = search(space, Effort(12, 4, 0), lambda batch: [each.values["attack"]["type"] == "B" for each in batch])
    assert best_of(done, maximise=True).values == {"attack": {"type": "B"}}  # type: ignore[union-attr]


def test_nothing_is_printed_and_optunas_own_settings_stay(capfd: pytest.CaptureFixture[str]) -> None:
    import optuna

    optuna.logging.set_verbosity(logging.DEBUG)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            search(SPACE, Effort(6, 3, 0), hill)
        assert optuna.logging.get_verbosity() == logging.DEBUG
    finally:
        optuna.logging.set_verbosity(optuna.logging.INFO)
    assert capfd.readouterr() == ("", "")
