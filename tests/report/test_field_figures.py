"""The figure of the matrix of published methods: its panels, cells, marks and colours."""

from dataclasses import replace

import numpy as np
import pytest
from field_samples import SCENES, field
from matplotlib.axes import Axes

from mast_zenoh.show.figures.style import Figure
from mast_zenoh.study.defences.matrix_figures import harm_by_scene

DEFENCES = ("KOfN", "SequentialConsistency", "Robosac", "Cad")
ATTACKS = ("coordinated", "BlindAreaConfusion", "Flood")


def panels(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.images]


@pytest.mark.usefixtures("unpainted")
def test_a_panel_for_each_kind_of_scene_has_a_number_for_each_attack_and_defence(drawn: list[Figure]) -> None:
    table = field(DEFENCES, ATTACKS)
    harm_by_scene(table)
    first, second = panels(drawn[0])
    assert [axes.get_title(loc="left") for axes in (first, second)] == ["4 poles", "4 cars"]
    assert [text.get_text() for text in first.get_yticklabels()] == ["no attack", *ATTACKS]
    assert [text.get_text() for text in second.get_xticklabels()] == list(DEFENCES)
    values = np.asarray(first.images[0].get_array())
    assert values.shape == (4, 4)
    assert values[1, 0] == pytest.approx(-2.5)
    texts = {(round(text.get_position()[0]), round(text.get_position()[1])): text for text in first.texts}
    assert len(texts) == 16
    assert (texts[0, 1].get_text(), texts[0, 1].get_fontstyle()) == ("\u22122.5", "normal")
    assert texts[0, 3].get_text() == "\u221226", "no decimals where they do not fit"
    assert texts[1, 1].get_fontstyle() == "italic", "its interval contains 0"


@pytest.mark.usefixtures("unpainted")
def test_colours_are_centred_at_no_change(drawn: list[Figure]) -> None:
    harm_by_scene(field(DEFENCES, ATTACKS))
    norms = [axes.images[0].norm for axes in panels(drawn[0])]
    assert {float(norm(0.0)) for norm in norms} == {0.5}
    assert {(norm.vmin, norm.vmax) for norm in norms} == {(-30.0, 30.0)}, "a flood of 26.4 is within"


@pytest.mark.usefixtures("unpainted")
def test_a_corner_marks_where_honest_agents_are_suspended_and_how_often(drawn: list[Figure]) -> None:
    harm_by_scene(field(DEFENCES, ATTACKS))
    sizes: dict[int, set[float]] = {}
    for patch in panels(drawn[0])[0].patches:
        corners = patch.get_path().vertices
        sizes.setdefault(round(float(corners[0, 0] + 0.5)), set()).add(round(float(np.ptp(corners[:, 1])), 2))
    assert not [text for text in drawn[0].texts if "Hatched" in text.get_text()]
    assert sizes == {1: {0.27}, 2: {0.48}}, "in 10 and in 80 % of the runs of two of the four defences"


@pytest.mark.parametrize(("counts", "scenes"), [((2,), ("4 poles",)), ((1, 3), ("4 poles", "8 poles, 4 cars"))])
def test_no_text_overlaps_another_or_leaves_the_figure(
    drawn: list[Figure], counts: tuple[int, ...], scenes: tuple[str, ...]
) -> None:
    many = (*(f"Defence{index}" for index in range(8)), "SequentialConsistency")
    harm_by_scene(field(many, ATTACKS, scenes, counts))
    figure = drawn[0]
    upright = [text for axes in figure.axes for text in (*axes.texts, *axes.get_yticklabels())]
    upright += [axes.title for axes in figure.axes] + [axes._left_title for axes in figure.axes]  # type: ignore[attr-defined]
    upright += [label for axes in figure.axes if not axes.images for label in axes.get_xticklabels()]
    slanted = [label for axes in panels(figure) for label in axes.get_xticklabels()]
    boxes = [text.get_window_extent() for text in upright if text.get_text()]
    low, high = figure.bbox.min, figure.bbox.max
    for box in [*boxes, *(text.get_window_extent() for text in slanted if text.get_text())]:
        assert (box.min >= low - 1.0).all()
        assert (box.max <= high + 1.0).all()
    for index, box in enumerate(boxes):
        assert not [other for other in boxes[index + 1 :] if box.shrunk(0.98, 0.9).overlaps(other.shrunk(0.98, 0.9))]


@pytest.mark.usefixtures("unpainted")
def test_the_words_say_where_a_defence_helps_and_harms_most() -> None:
    figure = harm_by_scene(field())["harm_by_scene"]
    assert "4 poles:" in figure.alt
    assert "2 adversaries, random" in figure.caption


@pytest.mark.usefixtures("unpainted")
def test_the_figure_explains_its_marks(drawn: list[Figure]) -> None:
    harm_by_scene(field(DEFENCES, ATTACKS, idle=True))
    (key,) = (text.get_text() for text in drawn[0].texts)
    words = key.replace("\n", " ")
    for mark in ("% interval contains", "Corner: an honest", "Hatched: the adv"):
        assert mark in words


@pytest.mark.usefixtures("unpainted")
def test_a_cell_whose_attack_never_took_place_is_hatched_and_has_no_colour(drawn: list[Figure]) -> None:
    figure = harm_by_scene(field(DEFENCES, ATTACKS, idle=True))["harm_by_scene"]
    (first, _) = panels(drawn[0])
    assert [patch.get_xy() for patch in first.patches if patch.get_hatch()] == [(-0.5, 0.5)]  # type: ignore[attr-defined]
    values = np.ma.filled(np.asarray(first.images[0].get_array(), float), np.nan)
    assert np.argwhere(np.isnan(values)).tolist() == [[1, 0]]
    assert "against coordinated" not in figure.alt.split("4 poles:")[1].split(" to ")[0]


@pytest.mark.usefixtures("unpainted")
def test_runs_without_an_attack_are_shown_once_for_all_numbers_of_adversaries(drawn: list[Figure]) -> None:
    harm_by_scene(field(DEFENCES, ATTACKS, SCENES[:1], (1, 2)))
    one, two = panels(drawn[0])
    assert [len(np.asarray(axes.images[0].get_array())) for axes in (one, two)] == [4, 3]
    assert one.get_position().y0 == pytest.approx(two.get_position().y0)
    assert two.get_ylim() == (2.5, -0.5)


@pytest.mark.usefixtures("unpainted")
def test_the_cells_of_a_single_defence_are_not_stretched(drawn: list[Figure]) -> None:
    harm_by_scene(field(DEFENCES[:1], ATTACKS))
    (axes, _) = panels(drawn[0])
    assert axes.get_position().width * drawn[0].get_figwidth() <= 1.0


def test_without_a_defence_or_an_attack_there_is_no_figure() -> None:
    table = field(defences=())
    assert harm_by_scene(table) == {}
    alone = replace(table, rows=[row for row in table.rows if not row.of["attack"]])
    assert harm_by_scene(alone) == {}
