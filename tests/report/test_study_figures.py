"""Study figures show each configuration once and connect neighbours only."""

from dataclasses import replace

import pytest
from study_samples import BASELINE, estimate, facts, grid, row

from mast_zenoh.metrics.study_results import Row, StudySeries
from mast_zenoh.show.figures import study
from mast_zenoh.show.figures.study import Panel, figures_over_trials, panels


def labels(panel: Panel) -> dict[str, list[str]]:
    return {label: [row.configuration for row in curve] for label, curve in panel.curves.items()}


def test_runs_that_sweep_one_parameter_share_a_panel_with_a_curve_each() -> None:
    rows = [BASELINE, *grid("a", n=(3, 1, 2)), *grid("b", n=(1, 2))]
    (panel,) = panels(rows, "baseline")
    assert (panel.x, panel.y, panel.ticks, panel.numeric) == ("n", "", (1, 2, 3), True)
    assert labels(panel) == {"a": ["a-1", "a-2", "a-3"], "b": ["b-1", "b-2"]}


def test_two_parameters_make_a_curve_for_each_value_of_the_second() -> None:
    rows = [BASELINE, *grid("a", n_adversaries=(1, 2), false_positives=(1.0, 5.0, 20.0))]
    (panel,) = panels(rows, "baseline")
    assert panel.x == "false_positives", "the one with the most values"
    assert labels(panel) == {
        "number of adversaries = 1": ["a-1-1.0", "a-1-5.0", "a-1-20.0"],
        "number of adversaries = 2": ["a-2-1.0", "a-2-5.0", "a-2-20.0"],
    }
    assert all(len({row.point["n_adversaries"] for row in curve}) == 1 for curve in panel.curves.values())


@pytest.mark.parametrize(
    ("values", "x", "y", "numeric"),
    [
        (dict(n=(1, 2, 3, 4), fp=(1.0, 2.0, 5.0, 10.0)), "n", "fp", True),  # a heat map
        (dict(n=(1, 2, 3, 4), kind=("k", "l", "m", "o")), "n", "", True),  # categories have no order
        (dict(kind=("far", "near", "all"), n=(1, 2)), "n", "", True),
        (dict(kind=("far", "near")), "kind", "", False),
        (dict(on=(True, False)), "on", "", False),
    ],
)
def test_numbers_are_on_the_x_axis_and_categories_are_not_connected(values, x: str, y: str, numeric: bool) -> None:
    (panel,) = panels([BASELINE, *grid("a", **values)], "baseline")
    assert (panel.x, panel.y, panel.numeric) == (x, y, numeric)
    assert y or panel.ticks == values[x]


def test_additional_parameters_make_a_panel_for_each_choice() -> None:
    result = panels([BASELINE, *grid("a", n=(1, 2, 3), start_s=(1.0, 4.0), kind=("far", "near"))], "baseline")
    assert [panel.title for panel in result] == ["a, kind = far", "a, kind = near"]
    assert list(labels(result[0])) == ["start (s) = 1", "start (s) = 4"]


@pytest.mark.parametrize(
    ("grids", "count"),
    [
        ([dict(n=(1, 2, 3))], 3),
        ([dict(n=(1, 2), fp=(1.0, 5.0), kind=("far", "near"))], 8),
        ([dict(n=(1, 2, 3, 4), fp=(1.0, 2.0, 5.0, 10.0)), dict(n=(1, 2))], 18),
    ],
)
def test_every_configuration_is_shown_exactly_once(grids, count: int) -> None:
    rows = [BASELINE, row("alone", {}, 1.0)]
    rows += [each for index, values in enumerate(grids) for each in grid(f"run{index}", **values)]
    labels = [
        row.configuration for panel in panels(rows, "baseline") for curve in panel.curves.values() for row in curve
    ]
    assert sorted(labels) == sorted(row.configuration for row in rows[1:])
    assert len(labels) == count + 1


@pytest.mark.heavy
def test_figures_are_reproducible_and_state_their_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [BASELINE, *grid("a", n=(1, 2), fp=(1.0, 5.0, 20.0)), *grid("b", n=(1, 2, 3, 4), fp=(1.0, 2.0, 5.0, 9.0))]
    drawn = []
    pictures = study._draw
    monkeypatch.setattr("mast_zenoh.show.figures.drawing.pdf", lambda figure: b"%PDF")  # which takes as long again
    monkeypatch.setattr(study, "_draw", lambda *words: drawn.append(pictures(*words)) or drawn[-1])
    first, again = figures_over_trials(rows, facts(rows)), figures_over_trials(rows, facts(rows))
    assert list(first) == ["increments", "increments_mission", "success"]
    assert {name: each.png for name, each in first.items()} == {name: each.png for name, each in again.items()}
    footer = drawn[0].get_supxlabel()
    assert "mean over 20 seeds \u00d7 3 scenes; 95 % interval over seeds of these scenes" in footer
    curves = [line for line in drawn[0].subfigs[0].axes[0].lines if len(line.get_xdata()) == 3]
    assert all((line.get_xdata()[1:] > line.get_xdata()[:-1]).all() for line in curves), "no line runs backwards"
    assert drawn[0].subfigs[1].axes[0].images, "four values of both: a heat map"


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize(
    ("seeds", "half", "footer", "caption"),
    [
        (20, 0.5, "interval over seeds", "Where a bar crosses 0, there may be no change."),
        (4, float("nan"), "interval below five", "Below five seeds there is no bar."),
        (
            *(20, float("nan"), "no interval where all seeds are equal"),
            "A point of five seeds or more without a bar is the same for every seed.",
        ),
    ],
)
def test_figures_explain_missing_bars(
    monkeypatch: pytest.MonkeyPatch, seeds: int, half: float, footer: str, caption: str
) -> None:
    added = {StudySeries("", "picture", "fp_iob"): estimate(2.0, half, seeds=seeds)}
    rows = [BASELINE, Row({"configuration": "a"}, 0, added)]
    footers = []
    pictures = study._draw
    monkeypatch.setattr(study, "_draw", lambda *words: footers.append(words[-1]) or pictures(*words))
    figure = figures_over_trials(rows, facts(rows))["increments"]
    assert footer in footers[0]
    assert figure.caption.endswith(f"picture. {caption}")


def test_success_begins_at_zero_adversaries_and_every_figure_is_also_a_pdf(tmp_path, monkeypatch) -> None:
    drawn = {}
    monkeypatch.setattr(study, "render", lambda name, figure, *_, **__: drawn.setdefault(name, figure))
    success = StudySeries("all", "mission", "success_fp")
    rows = [BASELINE, *grid("a", n_adversaries=(1, 2, 3))]
    rated = estimate(0.5)._replace(rate=True)
    rows[1:] = [replace(each, numbers={**each.numbers, success: rated}) for each in rows[1:]]
    figures_over_trials(rows, facts(rows))
    axes = drawn["success"].subfigs[0].axes[0]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["0", "1", "2", "3"]
    assert axes.get_xlim()[0] < 0.0
    monkeypatch.undo()
    for name, figure in figures_over_trials(rows, facts(rows)).items():
        figure.save(tmp_path)
        assert figure.names == [f"{name}.png", f"{name}.pdf"]
        assert (tmp_path / f"{name}.pdf").read_bytes().startswith(b"%PDF")
