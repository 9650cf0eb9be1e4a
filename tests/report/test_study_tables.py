"""Study tables have the same numbers in terminal, Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from kept_texts import assert_kept, printed
from scipy.stats import binomtest
from study_samples import BASELINE, estimate, facts, grid, row

from mast_zenoh.metrics.significance import holm
from mast_zenoh.metrics.study_results import FailedTrial, IdleAttack, SeriesEstimate, StudyRow, StudySeries, shares
from mast_zenoh.report.narrative.study import compare, other_changes, reservations, result
from mast_zenoh.report.tables import study
from mast_zenoh.report.tables.study_rows import over_trials
from mast_zenoh.report.tables.text_table import TextTable
from mast_zenoh.study.statistics import trial_estimate

ROWS = [BASELINE, *grid("uncoordinated", n=(1, 2, 3)), *grid("coordinated", 0.5, n=(1, 2, 3))]
FAILED = FailedTrial("coordinated-3", "intersection:1", 7, "RunError: on | purpose", "mast run coordinated --seed 7")


def with_more(row: StudyRow, **numbers: SeriesEstimate) -> StudyRow:
    """A row with more numbers, by owner, estimator and metric with underscores between."""
    named = {StudySeries(*name.split("__")): number for name, number in numbers.items()}
    return replace(row, estimates={**row.estimates, **named})


RARE = trial_estimate(np.array([[0.0] * 16 + [0.1, 0.02, 0.01, 0.27]]), (-np.inf, np.inf), paired=True)
ZEROS = [with_more(each, ego__picture__fn_iob=RARE, ego__mission__fn_iob=RARE) for each in ROWS[1:3]]
ODD = SeriesEstimate(3.0, 1.0, 2.5, 2.0, 3.0, seeds=6)
PEERS = [
    with_more(ROWS[1], all__pictures__deceived=estimate(0.25, 0.1)),
    with_more(ROWS[2], all__pictures__deceived=estimate(0.3, 0.1), all__channel__busy_ratio=estimate(0.6, 0.1)),
]
STUDIES: dict[str, tuple[list[StudyRow], list[FailedTrial]]] = {
    "failed": (ROWS, [FAILED]),
    "mostly_zero": ([BASELINE, *ZEROS], []),
    "changed_ego": (
        [BASELINE, with_more(ROWS[1], ego__local__fp_iob=estimate(0.5), ego__mission__near_misses=ODD)],
        [],
    ),
    "two_means": ([BASELINE, StudyRow("x", "x", {}, {StudySeries("ego", "picture", "fp_iob"): ODD})], []),
    "peers": ([BASELINE, *PEERS], []),
    "long_names": ([BASELINE, *grid("a_run_with_quite_a_long_name", n=(1, 2), false_positives=(5.0, 20.0))], []),
}


@pytest.mark.parametrize("name", STUDIES)
def test_tables_in_text_csv_latex_and_on_a_terminal(name: str) -> None:
    """Kept word by word; those that say the same in other words are kept for one study."""
    rows, failed = STUDIES[name]
    known = facts(rows, failed)
    terminal, markdown, latex = (
        printed(study.as_rich(rows, known)),
        study.as_markdown(rows, known),
        study.as_latex(rows, known),
    )
    numbers = study.as_csv(rows, known)
    more = {"failed": [markdown], "mostly_zero": [numbers, latex]}.get(name, [])
    assert_kept(f"study_{name}", terminal, *more)
    assert max(map(len, terminal.splitlines())) <= 80
    assert "…" not in terminal
    for line, after in pairwise(markdown.splitlines()):
        assert not after.startswith("|---") or line.count("|") == after.count("|")
    for tabular in latex.split(r"\end{tabular}"):
        lines = [line for line in tabular.splitlines() if line.endswith(r"\\")]
        assert len({line.count("&") for line in (lines[2:] if tabular.startswith("% needs") else lines)}) <= 1
    assert latex.isascii()
    lines = list(csv.DictReader(io.StringIO(numbers)))
    assert {line["configuration"] for line in lines} == {row.label for row in rows}
    assert len(lines) == sum(len(row.estimates) for row in rows)


def test_differences_that_are_mostly_zero_have_the_exact_interval_of_their_share() -> None:
    exact = binomtest(16, 20).proportion_ci(method="exact")
    assert (RARE.zero_share, RARE.zero_low, RARE.zero_high) == pytest.approx((0.8, exact.low, exact.high))
    assert RARE.trial_mean == pytest.approx(0.02)
    assert np.isnan([RARE.low, RARE.high]).all()
    assert pytest.approx(binomtest(0, 4).pvalue) == RARE.p, "the sign test of the others"
    assert over_trials(RARE) == "0.02 (0 in 80 % [56, 94])"
    often, never, scenes = (
        trial_estimate(np.array(values, float), (-np.inf, np.inf), paired=True)
        for values in ([[0, 0, 1, 2, 3]], [[0] * 5], [[0.1, 0.2, 0.3, 0.1, 0.2], [0] * 5, [0] * 5])
    )
    assert often.zero_share == 0.4
    assert not np.isnan([often.low, often.high, often.p]).any()
    assert (never.unchanged, never.certain) == (True, False)
    assert over_trials(never) == "0.00 (0 in 100 % [48, 100])"
    assert scenes.zero_share == pytest.approx(2 / 3), "counted by trial: no seed's average over the scenes is 0"


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        (SeriesEstimate(3.42, 1.2, 3.4, 3.1, 3.7, seeds=20), "3.40 [3.10, 3.70]"),
        (SeriesEstimate(), "\u2013"),
        (SeriesEstimate(3.4, 1.2, 3.4, seeds=4), "3.40 (n < 5)"),
        (SeriesEstimate(0.0, 0.0, 0.0, seeds=20), "0.00 (all equal)"),
        (SeriesEstimate(trial_mean=0.0163, low=0.0143, high=0.0183, seeds=20), "0.016 [0.014, 0.018]"),
        (SeriesEstimate(trial_mean=0.9, low=0.683, high=0.988, seeds=20, rate=True), "90 % [68, 99]"),
    ],
)
def test_estimates_show_their_interval_or_why_there_is_none(numbers: SeriesEstimate, text: str) -> None:
    assert over_trials(numbers) == text


def test_shares_add_up_to_one_over_the_causes_that_occur() -> None:
    assert shares(ROWS[1], "fp") == {"inserted": pytest.approx(2 / 3), "clutter": pytest.approx(1 / 3)}
    assert shares(ROWS[1], "fn") == {}


def test_holm_adjusts_step_by_step() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_comparisons_outside_the_tables_are_counted_separately() -> None:
    extra = replace(
        ROWS[1], estimates={**ROWS[1].estimates, StudySeries("ego", "mission", "my_metric_iob"): estimate(1.0)}
    )
    comparisons = compare([BASELINE, extra], "baseline")
    assert comparisons.count == 5, (
        "fp and fn of picture and mission, fp of the compromised; those all equal have no test"
    )
    assert comparisons.others == 1
    assert comparisons.bonferroni == pytest.approx(0.01)
    assert comparisons.remaining() == 3


def test_result_is_the_largest_significant_change_of_what_the_ego_acts_on() -> None:
    text = result(ROWS, facts(ROWS), compare(ROWS, "baseline"))
    assert text == (
        "The clearest change: in uncoordinated-3 the ego with the "
        "picture has 9.00 more false objects a frame [8.50, 9.50] than the baseline."
    )
    fewer = [BASELINE, row("a", {}, -2.0)]
    assert "2.00 fewer false objects a frame [1.50, 2.50]" in result(fewer, facts(fewer), compare(fewer, "baseline"))


@pytest.mark.parametrize(
    ("estimates", "text"),
    [
        (estimate(0.1, 0.5, p=0.6), "in any estimate of the ego distinguishably, in 1 comparison"),
        (
            SeriesEstimate(4.0, 1.0, 4.0, seeds=3),
            "in the picture, too few seeds for an interval: in a the picture has 4.00 more false",
        ),
        (
            SeriesEstimate(0.0, 0.0, 0.0, zero_share=1.0, seeds=20),
            "No configuration changes false or missed objects in any estimate of the ego, in any trial",
        ),
        (None, "No trial has results for its baseline"),
    ],
)
def test_result_without_a_significant_change_is_stated(estimates: SeriesEstimate | None, text: str) -> None:
    assert text in words(**({"fp_iob": estimates} if estimates else {}))[0]


def words(**increments: SeriesEstimate) -> tuple[str, list[str]]:
    """The result and other changes of a study in which `a` changes the picture."""
    known = {StudySeries("ego", "picture", name): each for name, each in increments.items()}
    rows = [BASELINE, StudyRow("a", "a", {}, known)]
    comparisons = compare(rows, "baseline")
    return result(rows, facts(rows), comparisons), other_changes(rows, facts(rows), comparisons)


SAME = SeriesEstimate(0.57, 0.5, 0.57, scenes=1, seeds=5)


def test_equal_difference_in_all_seeds_is_certain_and_precedes_rmse() -> None:
    headline, others = words(fn_iob=SAME, fp_iob=estimate(0.0, p=0.9), rmse_m_iob=estimate(0.0006, 0.0002))
    assert headline == (
        "The clearest change: in a the picture has 0.57 more missed objects a "
        "frame than the baseline, "
        "in all 5 seeds; no spread, so no interval."
    )
    assert "Not distinguishable from the baseline: false objects." in others
    assert not any("missed objects" in sentence for sentence in others)


def test_headline_is_the_clearest_of_all_changes_and_ignores_rmse_below_one_centimetre() -> None:
    rmse, switches, nothing = estimate(0.2, 0.1, p=1e-4), estimate(0.1, 0.05, p=1e-5), estimate(0.0, p=0.9)
    assert "0.10 more identity switches" in words(fp_iob=nothing, id_switches_iob=switches, rmse_m_iob=rmse)[0]
    shrunk = estimate(1.8, 0.1, p=1e-9)
    assert "1.80 m more error in the lengths" in words(fp_iob=nothing, length_error_m_iob=shrunk, rmse_m_iob=rmse)[0]
    assert "0.20 m more RMSE" in words(fp_iob=nothing, rmse_m_iob=rmse)[0]
    headline, others = words(fp_iob=nothing, rmse_m_iob=estimate(0.0006, 0.0002))
    assert headline.startswith(
        "No configuration changes false or missed objects in any estimate of the ego distinguishably"
    )
    assert any(sentence.startswith("RMSE: in a the picture has 0.0006 m more") for sentence in others)


def test_a_change_that_is_distinguishable_alone_is_not_said_to_be_indistinct() -> None:
    _, others = words(fp_iob=estimate(0.0, p=0.9), length_error_m_iob=estimate(0.4, 0.2, p=0.03))
    text = "Distinguishable from the baseline if read alone, not if all 2 comparisons are read together: lengths."
    assert text in others
    assert "Not distinguishable from the baseline: false objects." in others


def test_the_headline_never_denies_a_change_that_remains_after_holm() -> None:
    """Of 40 studies: it names a marked change if there is any, and the one with the smallest p."""
    rng = np.random.default_rng(5)
    for _ in range(40):
        p_values = 10.0 ** rng.uniform(-5.0, 0.0, (4, 3))
        names = ("fp_iob", "fn_iob", "rmse_m_iob")
        rows = [
            StudyRow(
                f"a{k}",
                "a",
                {},
                {StudySeries("ego", "picture", n): estimate(2.0, p=p) for n, p in zip(names, of, strict=True)},
            )
            for k, of in enumerate(p_values)
        ]
        comparisons = compare([BASELINE, *rows], "baseline")
        text = result([BASELINE, *rows], facts([BASELINE, *rows]), comparisons)
        assert ("distinguishably" in text) == (not comparisons.remaining())
        if comparisons.remaining():
            clearest = int(p_values.argmin())
            phrase = ("false objects", "missed objects", "RMSE")[clearest % 3]
            assert re.search(rf"in a{clearest // 3} the picture has .*{phrase}", text)


def test_equal_values_in_all_trials_are_reported_as_unchanged() -> None:
    equal = SeriesEstimate(0.0, 0.0, 0.0, zero_share=1.0, scenes=1, seeds=5)
    _, others = words(fp_iob=estimate(2.0), fn_iob=estimate(0.0, p=0.9), id_switches_iob=equal)
    assert "Unchanged in all trials: identity switches." in others
    assert "Not distinguishable from the baseline: missed objects." in others
    _, others = words(fp_iob=estimate(2.0), id_switches_iob=replace(equal, seeds=4))
    assert not any("identity switches" in sentence for sentence in others), "too few for a statement"


def test_seeds_left_out_are_reported_per_affected_number() -> None:
    whole = replace(estimate(1.0), seeds=18, left_out=2)
    some = {StudySeries("ego", "picture", "fp"): estimate(1.0), StudySeries("ego", "picture", "rmse_m"): whole}
    rows = [StudyRow("a", "a", {}, {StudySeries("ego", "picture", "fp"): whole}), StudyRow("b", "b", {}, some)]
    rows.append(StudyRow("c", "c", {}, {}))
    assert reservations(rows, facts(rows)) == [
        "a: 2 of 20 seeds left out: a trial failed or has no such value.",
        "b: 2 of 20 seeds left out for RMSE m (picture): a trial failed or has no such value.",
        "c: no trial has results.",
    ]


def test_attacks_that_never_began_are_reported_first() -> None:
    late = IdleAttack("uncoordinated-1", 4.0, 3.8)
    sentences = "The attack of uncoordinated-1 never began: it begins at 4 s, and the trials end after 3.8 s."
    alone = [BASELINE, ROWS[1]]
    known = replace(facts(alone), idle=(late,))
    assert result(alone, known, compare(alone, "baseline")) == sentences
    assert other_changes(alone, known, compare(alone, "baseline")) == []
    both = replace(facts(ROWS), idle=(late,))
    assert result(ROWS, both, compare(ROWS, "baseline")).startswith(
        f"{sentences} The clearest change: in uncoordinated-3 "
    )
    assert sentences.replace("-1", " n=1") in study.as_markdown(ROWS, both).split("##")[0]
    part = replace(late, scenes=("short:0",))
    text = result(alone, replace(known, idle=(part,)), compare(alone, "baseline"))
    assert text.startswith("The attack of uncoordinated-1 never began in short:0: ")
    assert "The clearest change" in text


def test_a_wide_table_has_parts_of_whole_groups_and_one_caption() -> None:
    groups = ["", *["one"] * 3, *["two"] * 2, *["three"] * 7]
    table = TextTable("Wide", "all of it", ["", *"abcdefghijkl"], [["row", *"ABCDEFGHIJKL"]], 1, groups=groups)
    parts = table.parts(5)
    assert ["".join(part.headings) for part in parts] == ["abcde", "fghi", "jkl"]
    assert ["".join(part.lines[0]) for part in parts] == ["rowABCDE", "rowFGHI", "rowJKL"]
    assert [len({*part.groups}) - 1 for part in parts] == [2, 1, 1]
    assert [part.about for part in parts] == ["", "", "all of it"]
