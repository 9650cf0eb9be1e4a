"""The tables and the figure of a search."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from rich.console import Console
from search_samples import BASELINE, DEFAULT, changed, results, search_row, with_rows

from mast_zenoh.metrics.study_results import Statistic
from mast_zenoh.show.figures.style import Figure
from mast_zenoh.study.search import report as search_figures
from mast_zenoh.study.search.plan import SEARCHED
from mast_zenoh.study.search.report import candidates_csv, search_tables, short_names
from mast_zenoh.study.search.results import SearchResults


def shown(of: SearchResults) -> str:
    console = Console(width=200, file=io.StringIO(), record=True)
    console.print(search_tables(of).as_rich())
    return console.export_text()


def test_terminal_tables_fit_80_columns_and_have_all_held_out_numbers() -> None:
    text = shown(results())
    assert max(map(len, text.splitlines())) <= 80
    words = " ".join(text.split())
    for part in ("Maximised: missed objects + false objects per frame, picture", "fraction_false_negatives", "1.235"):
        assert part in words
    for part in ("[2.55,", "2.95]", "[1.30,", "1.70]", "[0.80,", "1.20]"):
        assert part in words
    assert "…" not in text


def test_a_search_that_found_nothing_better_than_the_default_says_so() -> None:
    assert "nothing better" not in shown(results())
    for default, maximise in ((3.25, True), (3.5, True), (3.25, False), (3.0, False)):
        made = results(maximise=maximise)
        words = " ".join(
            shown(with_rows(made, {DEFAULT: changed(made.rows[DEFAULT], search=Statistic(default))})).split()
        )
        assert f"The search found nothing better than the default: {default:.2f} with its parameters, 3.25" in words


def test_without_a_value_of_no_attack_only_the_plain_optimism_is_given() -> None:
    made = with_rows(results(), {BASELINE: search_row(BASELINE)})
    assert not made.over_baseline
    words = " ".join(shown(made).split())
    assert "0.50 too good. " in words
    assert "difference from no attack," not in words


def test_csv_has_a_line_for_each_configuration_and_all_digits() -> None:
    lines = list(csv.DictReader(search_tables(results()).as_csv().splitlines()))
    values = {(line["configuration"], line["measure"]): line["value"] for line in lines}
    assert list(dict.fromkeys(line["configuration"] for line in lines)) == [BASELINE, DEFAULT, SEARCHED]
    measures = ("held_out", "over_baseline", "over_default", "optimism")
    assert [float(values[SEARCHED, name]) for name in measures] == [2.75, 1.5, 1.0, 0.5]
    assert values[BASELINE, "over_baseline"] == ""


def test_candidates_csv_has_every_candidate_and_the_best_up_to_it() -> None:
    lines = list(csv.DictReader(candidates_csv(results()).splitlines()))
    assert [line["candidate"] for line in lines] == ["1", "2", "3", "4", "5"]
    assert [line["batch"] for line in lines] == ["1", "1", "2", "2", "3"]
    assert [line["value"] for line in lines] == ["2.5", "", "3.25", "3.0", "3.25"]
    assert [line["best"] for line in lines] == ["2.5", "2.5", "3.25", "3.25", "3.25"]
    assert lines[0]["attack.budget"] == "1.23456789"


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["a.b.x", "a.c.y"], ["x", "y"]),
        (["a.b.x", "a.c.x"], ["b.x", "c.x"]),
        (["x", "attack.x"], ["x", "attack.x"]),
        (["n_adversaries"], ["n_adversaries"]),
    ],
)
def test_names_of_parameters_are_short_and_stay_different(names: list[str], short: list[str]) -> None:
    assert short_names(names) == short


def drawn(of: SearchResults, monkeypatch: pytest.MonkeyPatch) -> Figure:
    """The figure before it is rendered."""
    kept: list[Figure] = []
    monkeypatch.setattr(search_figures, "render", lambda _, figure, *__, **___: kept.append(figure))
    search_figures.search_figure(of)
    FigureCanvasAgg(kept[0])
    kept[0].draw_without_rendering()
    return kept[0]


def points(axes: Axes) -> list[tuple[float, float]]:
    """The points of all error bars."""
    return [tuple(map(float, each.lines[0].get_xydata()[0])) for each in axes.containers]  # type: ignore[misc]


def test_the_figure_shows_differences_from_no_attack_on_both_kinds_of_seeds(monkeypatch) -> None:
    in_order, held_out = drawn(results(), monkeypatch).axes
    offsets = np.asarray(in_order.collections[0].get_offsets())
    assert offsets[:, 0].tolist() == [1, 2, 3, 4, 5]
    assert offsets[[0, 2], 1].tolist() == [1.0, 1.75]
    assert points(held_out) == [(0.0, 0.5), (1.0, 1.5)]
    assert [text.get_text() for text in held_out.get_xticklabels()] == [DEFAULT, SEARCHED]
    rings = [line for axes in (in_order, held_out) for line in axes.lines if line.get_markerfacecolor() == "none"]
    assert [tuple(map(float, line.get_xydata()[0])) for line in rings] == [(3.0, 1.75), (1.0, 1.75)]
    assert in_order.get_ylabel().replace("\n", " ").endswith("per frame, picture, minus no attack")


def test_without_a_value_of_no_attack_the_figure_shows_the_values_themselves(monkeypatch) -> None:
    made = with_rows(results(), {BASELINE: search_row(BASELINE)})
    in_order, held_out = drawn(made, monkeypatch).axes
    assert points(held_out) == [(0.0, 1.75), (1.0, 2.75)]
    assert not in_order.get_ylabel().endswith("no attack")
