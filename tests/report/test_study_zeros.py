"""Differences that are 0 in most trials have the exact interval of their share, in every output of a study."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import binomtest
from study_samples import BASELINE, facts, grid

from mast_zenoh.metrics.study_results import StudySeries
from mast_zenoh.report.figures.study import figures_over_trials
from mast_zenoh.report.html import write_trials_page
from mast_zenoh.report.tables import study
from mast_zenoh.report.tables.study_rows import over_trials
from mast_zenoh.study.statistics import trial_estimate

UNLIMITED = (-np.inf, np.inf)
#: Added missed objects of one scene with 20 seeds: 16 are 0.
RARE = np.array([[0.0] * 16 + [0.1, 0.02, 0.01, 0.27]])
MISSED = trial_estimate(RARE, UNLIMITED, paired=True)
SHARE = "(0 in 80 % [56, 94])"
WARNING = "The mean has no interval: it would be too narrow."


def rows():
    attacked = grid("uncoordinated", n=(1, 2))
    changed = {StudySeries("ego", estimator, "fn_iob"): MISSED for estimator in ("picture", "mission")}
    return [BASELINE, *(replace(row, estimates={**row.estimates, **changed}) for row in attacked)]


def terminal() -> str:
    page = io.StringIO()
    Console(file=page, width=80).print(study.as_rich(rows(), facts(rows())))
    return page.getvalue()


def test_the_share_of_zeros_has_the_exact_binomial_interval_instead_of_one_of_the_mean() -> None:
    exact = binomtest(16, 20).proportion_ci(method="exact")
    assert (MISSED.zero_share, MISSED.zero_low, MISSED.zero_high) == pytest.approx((0.8, exact.low, exact.high))
    assert MISSED.trial_mean == pytest.approx(0.02)
    assert np.isnan([MISSED.low, MISSED.high]).all()
    assert pytest.approx(binomtest(0, 4).pvalue) == MISSED.p, "the sign test of the others"
    assert over_trials(MISSED) == f"0.02 {SHARE}"


def test_differences_that_are_rarely_zero_keep_the_interval_of_their_mean() -> None:
    often = trial_estimate(np.array([[0.0, 0.0, 1.0, 2.0, 3.0]]), UNLIMITED, paired=True)
    assert often.zero_share == 0.4
    assert not np.isnan([often.low, often.high, often.p]).any()


def test_zeros_are_counted_by_trial_not_by_the_average_of_a_seed() -> None:
    """Three scenes of which one changes leave no seed's average at 0."""
    values = np.array([[0.1, 0.2, 0.3, 0.1, 0.2], [0.0] * 5, [0.0] * 5])
    assert trial_estimate(values, UNLIMITED, paired=True).zero_share == pytest.approx(2 / 3)


def test_unchanged_differences_are_still_unchanged_and_say_how_sure_that_is() -> None:
    never = trial_estimate(np.zeros((1, 5)), UNLIMITED, paired=True)
    assert never.unchanged
    assert not never.certain
    assert over_trials(never) == "0.00 (0 in 100 % [48, 100])"


def test_terminal_markdown_and_html_tables_warn_of_means_that_are_mostly_zero(tmp_path: Path) -> None:
    page = write_trials_page(tmp_path, rows(), facts(rows()), figures_over_trials(rows(), facts(rows())))
    texts = (terminal(), study.as_markdown(rows(), facts(rows())), page.read_text("utf-8"))
    for text in texts:
        assert SHARE in text
        assert WARNING in " ".join(text.split())
    assert max(map(len, texts[0].splitlines())) <= 80


def test_csv_has_the_share_and_latex_the_warning() -> None:
    lines = list(csv.DictReader(io.StringIO(study.as_csv(rows(), facts(rows())))))
    line = next(line for line in lines if line["metric"] == "fn_iob")
    assert (line["low"], line["high"]) == ("", "")
    assert float(line["p"]) == 0.125
    assert float(line["zero_share"]) == 0.8
    assert float(line["zero_low"]) == pytest.approx(0.563, abs=1e-3)
    latex = study.as_latex(rows(), facts(rows()))
    assert WARNING in latex
    assert r"(0 \mbox{ in } 80 \% [56, 94])" in latex
