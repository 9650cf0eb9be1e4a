"""Study tables have the same numbers in terminal, Markdown, CSV and LaTeX."""

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

from mast_zenoh.metrics.study_results import FailedTrial, IdleAttack, Row, Statistic, StudySeries, holm, shares
from mast_zenoh.show.findings.of_study import clearest_change, compare, other_changes, reservations
from mast_zenoh.show.number_text import over_trials
from mast_zenoh.show.tables import study
from mast_zenoh.show.tables.text_table import TextTable
from mast_zenoh.study.statistics import trial_estimate

ROWS = [BASELINE, *grid("uncoordinated", n=(1, 2, 3)), *grid("coordinated", 0.5, n=(1, 2, 3))]
FAILED = FailedTrial("coordinated-3", "intersection:1", 7, "RunError: on | purpose", "mast run coordinated --seed 7")


def with_more(row: Row, **numbers: Statistic) -> Row:
    """A row with more numbers, by owner, estimator and metric with underscores between."""
    split = ((name.removeprefix("ego").split("__"), number) for name, number in numbers.items())
    named = {StudySeries(*parts): number for parts, number in split}
    return replace(row, numbers={**row.numbers, **named})


RARE = trial_estimate(np.array([[0.0] * 16 + [0.1, 0.02, 0.01, 0.27]]), (-np.inf, np.inf), paired=True)
ZEROS = [with_more(each, ego__picture__fn_iob=RARE, ego__mission__fn_iob=RARE) for each in ROWS[1:3]]
ODD = Statistic(mean=3.0, std=1.0, value=2.5, low=2.0, high=3.0, seeds=6)
PEERS = [
    with_more(ROWS[1], all__pictures__deceived=estimate(0.25, 0.1)),
    with_more(ROWS[2], all__pictures__deceived=estimate(0.3, 0.1), all__channel__busy_ratio=estimate(0.6, 0.1)),
]
STUDIES: dict[str, tuple[list[Row], list[FailedTrial]]] = {
    "failed": (ROWS, [FAILED]),
    "mostly_zero": ([BASELINE, *ZEROS], []),
    "changed_ego": (
        [BASELINE, with_more(ROWS[1], ego__local__fp_iob=estimate(0.5), ego__mission__near_misses=ODD)],
        [],
    ),
    "two_means": ([BASELINE, Row({"configuration": "x"}, 0, {StudySeries("", "picture", "fp_iob"): ODD})], []),
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
        assert len({line.count("&") for line in lines}) <= 1
    assert all(line.isascii() for line in latex.splitlines() if not line.startswith("%"))
    lines = list(csv.DictReader(io.StringIO(numbers)))
    assert {line["configuration"] for line in lines} == {row.configuration for row in rows}
    assert len(lines) == sum(len(row.numbers) for row in rows)


def test_differences_that_are_mostly_zero_have_the_exact_interval_of_their_share() -> None:
    exact = binomtest(16, 20).proportion_ci(method="exact")
    assert (RARE.zero_share, RARE.zero_low, RARE.zero_high) == pytest.approx((0.8, exact.low, exact.high))
    assert RARE.value == pytest.approx(0.02)
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


def test_columns_of_a_users_metric_name_its_unit() -> None:
    described = replace(facts(ROWS), own={"my_metric": {"unit": "objects"}})
    assert "my_metric (objects)" in study.as_markdown(ROWS, described)


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        (Statistic(mean=3.42, std=1.2, value=3.4, low=3.1, high=3.7, seeds=20), "3.40 [3.10, 3.70]"),
        (Statistic(), "\u2013"),
        (Statistic(mean=3.4, std=1.2, value=3.4, seeds=4), "3.40 (n < 5)"),
        (Statistic(mean=0.0, std=0.0, value=0.0, seeds=20), "0.00 (all equal)"),
        (Statistic(value=0.0163, low=0.0143, high=0.0183, seeds=20), "0.016 [0.014, 0.018]"),
        (Statistic(value=0.9, low=0.683, high=0.988, seeds=20, rate=True), "90 % [68, 99]"),
        (Statistic(value=1.0, low=1.0, high=1.0, seeds=20), "1.00 [1.00, 1.00]"),
    ],
)
def test_estimates_show_their_interval_or_why_there_is_none(numbers: Statistic, text: str) -> None:
    assert over_trials(numbers) == text


def test_shares_add_up_to_one_over_the_causes_that_occur() -> None:
    assert shares(ROWS[1], "fp") == {"inserted": pytest.approx(2 / 3), "clutter": pytest.approx(1 / 3)}
    assert shares(ROWS[1], "fn") == {}


def test_holm_adjusts_step_by_step() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_comparisons_outside_the_tables_are_counted_separately() -> None:
    extra = replace(ROWS[1], numbers={**ROWS[1].numbers, StudySeries("", "mission", "my_metric_iob"): estimate(1.0)})
    comparisons = compare([BASELINE, extra], "baseline")
    assert comparisons.count == 5, (
        "fp and fn of picture and mission, fp of the compromised; those all equal have no test"
    )
    assert comparisons.others == 1
    assert comparisons.bonferroni == pytest.approx(0.01)
    assert comparisons.remaining() == 3


def words(rows: list[Row], idle: IdleAttack | None = None) -> list[str]:
    """The result, other changes and reservations of a study."""
    known = replace(facts(rows), idle=() if idle is None else (idle,))
    comparisons = compare(rows, "baseline")
    others = [f"  {each}" for each in other_changes(rows, known, comparisons)]
    return [clearest_change(rows, known, comparisons), *others, *(f"  ! {each}" for each in reservations(rows, known))]


def picture(**increments: Statistic) -> list[Row]:
    """A study in which `a` changes the picture."""
    return [
        BASELINE,
        Row({"configuration": "a"}, 0, {StudySeries("", "picture", n): each for n, each in increments.items()}),
    ]


NOTHING, TINY = estimate(0.0, p=0.9), estimate(0.0006, 0.0002)
SAME = Statistic(mean=0.57, std=0.5, value=0.57, scenes=1, seeds=5)
EQUAL = Statistic(mean=0.0, std=0.0, value=0.0, zero_share=1.0, scenes=1, seeds=5)
WHOLE = estimate(1.0)._replace(seeds=18, left_out=2)
RMSE, SWITCHES = estimate(0.2, 0.1, p=1e-4), estimate(0.1, 0.05, p=1e-5)
LATE = IdleAttack("uncoordinated-1", 4.0, 3.8)
OF_STUDIES: dict[str, tuple[list[Row], IdleAttack | None]] = {
    "more false objects": (ROWS, None),
    "fewer false objects": ([BASELINE, row("a", {}, -2.0)], None),
    "no clear change": (picture(fp_iob=estimate(0.1, 0.5, p=0.6)), None),
    "too few seeds": (picture(fp_iob=Statistic(mean=4.0, std=1.0, value=4.0, seeds=3)), None),
    "no change in any trial": (picture(fp_iob=EQUAL._replace(seeds=20)), None),
    "no results": (picture(), None),
    "equal in all seeds": (picture(fn_iob=SAME, fp_iob=NOTHING, rmse_m_iob=TINY), None),
    "identity switches": (picture(fp_iob=NOTHING, id_switches_iob=SWITCHES, rmse_m_iob=RMSE), None),
    "lengths": (picture(fp_iob=NOTHING, length_error_m_iob=estimate(1.8, 0.1, p=1e-9), rmse_m_iob=RMSE), None),
    "RMSE": (picture(fp_iob=NOTHING, rmse_m_iob=RMSE), None),
    "RMSE below one centimetre": (picture(fp_iob=NOTHING, rmse_m_iob=TINY), None),
    "distinguishable alone": (picture(fp_iob=NOTHING, length_error_m_iob=estimate(0.4, 0.2, p=0.03)), None),
    "equal values": (picture(fp_iob=estimate(2.0), fn_iob=NOTHING, id_switches_iob=EQUAL), None),
    "equal values of few seeds": (picture(fp_iob=estimate(2.0), id_switches_iob=EQUAL._replace(seeds=4)), None),
    "seeds left out of all": (picture(fp=WHOLE), None),
    "seeds left out of RMSE": (picture(fp=estimate(1.0), rmse_m=WHOLE), None),
    "an attack that never began": ([BASELINE, ROWS[1]], LATE),
    "one of several attacks never began": (ROWS, LATE),
    "never began in one scene": ([BASELINE, ROWS[1]], replace(LATE, scenes=("short:0",))),
}


def test_the_result_of_a_study_is_its_clearest_change_or_why_there_is_none() -> None:
    lines = [line for name, case in OF_STUDIES.items() for line in (f"{name}:", *words(*case), "")]
    assert_kept("results_of_studies", *lines)
    markdown = study.as_markdown(ROWS, replace(facts(ROWS), idle=(LATE,)))
    assert "uncoordinated n=1 never" in markdown.split("##")[0]


def test_the_headline_never_denies_a_change_that_remains_after_holm() -> None:
    """Of 40 studies: it names a marked change if there is any, and the one with the smallest p."""
    rng = np.random.default_rng(5)
    for _ in range(40):
        p_values = 10.0 ** rng.uniform(-5.0, 0.0, (4, 3))
        names = ("fp_iob", "fn_iob", "rmse_m_iob")
        rows = [
            Row(
                {"configuration": f"a{k}"},
                0,
                {StudySeries("", "picture", n): estimate(2.0, p=p) for n, p in zip(names, of, strict=True)},
            )
            for k, of in enumerate(p_values)
        ]
        comparisons = compare([BASELINE, *rows], "baseline")
        text = clearest_change([BASELINE, *rows], facts([BASELINE, *rows]), comparisons)
        assert ("distinguishably" in text) == (not comparisons.remaining())
        if comparisons.remaining():
            clearest = int(p_values.argmin())
            phrase = ("false objects", "missed objects", "RMSE")[clearest % 3]
            assert re.search(rf"a{clearest // 3}.*picture.*{phrase}", text)


def test_a_wide_table_has_parts_of_whole_groups_and_one_caption() -> None:
    groups = ["", *["one"] * 3, *["two"] * 2, *["three"] * 7]
    table = TextTable("Wide", "all of it", ["", *"abcdefghijkl"], [["row", *"ABCDEFGHIJKL"]], 1, groups=groups)
    parts = table.parts(5)
    assert ["".join(part.headings) for part in parts] == ["abcde", "fghi", "jkl"]
    assert ["".join(part.lines[0]) for part in parts] == ["rowABCDE", "rowFGHI", "rowJKL"]
    assert [len({*part.groups}) - 1 for part in parts] == [2, 1, 1]
    assert [part.about for part in parts] == ["", "", "all of it"]
