"""The figures of a matrix of defences."""

import io
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from defence_samples import agent, matrix, panel, row
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

from mast_zenoh.metrics.study_results import BINOMIAL, Statistic
from mast_zenoh.show.figures.plots import LOG_ODDS, draw_agent, legend, trust_figure
from mast_zenoh.show.figures.style import Figure
from mast_zenoh.show.palette import ADVERSARY_ON_LIGHT
from mast_zenoh.study.defences.matrix_figures import figures_of_defences


@pytest.mark.usefixtures("unpainted")
def test_every_figure_is_drawn_and_names_the_worst_adversary_in_words() -> None:
    figures = figures_of_defences(matrix())
    assert list(figures) == [
        *("defence_matrix", "damage_over_adversaries", "detection_delay", "roc", "trust_over_time")
    ]
    assert "Ghost, 1 adversary" in figures["defence_matrix"].alt
    assert "Wall 0.90" in figures["roc"].alt
    assert all("pdf" in figure.files for figure in figures.values()), "for print"


@pytest.mark.usefixtures("unpainted")
def test_the_heat_maps_have_a_scale_and_explain_their_marks(drawn: list[Figure]) -> None:
    whole = matrix()
    silent = {"attacked": Statistic(0.0, 0.0, 0.1, 48, 0, BINOMIAL)}
    rows = [*(each for each in whole.rows if (each.of["defence"], each.of["attack"]) != ("Wall", "Ghost"))]
    figures_of_defences(replace(whole, rows=[*rows, row("Wall", "Ghost", **silent)]))
    maps, scale = drawn[0].axes
    assert scale.get_xlabel() == "wrong objects added per frame"
    key = drawn[0].texts[0].get_text().replace("\n", " ")
    assert key.startswith("Italic: the 95")
    assert "Hatched: the adversaries" in key
    assert [patch.get_xy() for patch in maps.patches if patch.get_hatch()] == [(0.5, -0.5)]  # type: ignore[attr-defined]


@pytest.mark.usefixtures("unpainted")
def test_defences_that_suspend_nobody_have_no_curve_and_are_named() -> None:
    caption = figures_of_defences(replace(matrix(), not_suspending=["Cad"]))["detection_delay"].caption
    assert caption.endswith("Not drawn, as they suspended nobody: Cad.")
    assert "Not drawn" not in figures_of_defences(matrix())["detection_delay"].caption


@pytest.mark.heavy
def test_trust_over_time_has_a_panel_per_trial_and_says_how_many_are_missing() -> None:
    small, large = (trust_figure(matrix(panels=count).panels, 0) for count in (1, 12))
    assert large.pixels[1] > 3 * small.pixels[1]
    assert "Wall against Ghost11 (1, worst)" in large.alt
    assert "more pairs" not in large.caption
    assert "7 more pairs are not shown" in trust_figure(matrix().panels, 7).caption


def test_lies_are_drawn_in_the_colour_of_adversaries() -> None:
    image = matplotlib.image.imread(io.BytesIO(trust_figure([panel("a")], 0).png))[..., :3]
    lies = (np.abs(image - to_rgb(ADVERSARY_ON_LIGHT)) < 0.12).all(axis=-1)
    assert lies.sum() > 200


def test_log_odds_are_drawn_at_their_limits() -> None:
    figure = Figure()
    axes = figure.subplots()
    draw_agent(axes, agent("ego"), 15.0, LOG_ODDS, named=False)
    (line,) = axes.lines
    drawn = np.asarray(line.get_ydata(), float)
    assert (drawn.min(), drawn[0]) == (0.0, (4.5 + 10.0) / 20.0), "-30 is drawn at -10"
    assert [text.get_text() for text in axes.get_yticklabels()] == ["\u221210", "0", "10"]
    assert not [patch for patch in axes.patches if isinstance(patch, Rectangle)]


def test_the_legend_has_what_is_shown() -> None:
    labels = [handle.get_label() for handle in legend(panel("a").agents, LOG_ODDS)]
    assert labels == [LOG_ODDS.label, "taken to be faulty", "suspended", "lies", "is faulty"]
    assert [handle.get_label() for handle in legend([agent("ego")], LOG_ODDS)] == [LOG_ODDS.label]
    doubted = agent("ego", states={"faulty": [], "suspended": [], "undecided": [(2.0, 9.0)]})
    assert [handle.get_label() for handle in legend([doubted], LOG_ODDS)] == [LOG_ODDS.label, "undecided"]
