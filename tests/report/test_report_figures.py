"""Figures show the right content, colours and clipping."""

import io
from collections.abc import Callable, Mapping

import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb

from mast_zenoh.arrays.geometry import rotation_from_yaw
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.run import Run
from mast_zenoh.sensing.sensors import Camera
from mast_zenoh.show.figures.camera import Eye, clip_polygon
from mast_zenoh.show.figures.drawing import birdseye_figure, camera_figure, side_by_side_figure
from mast_zenoh.show.figures.legend import draw_legend, legend_entries
from mast_zenoh.show.figures.over_time import counts_over_time
from mast_zenoh.show.figures.style import THEMES, Figure, png
from mast_zenoh.show.figures.view import frame_view
from mast_zenoh.show.palette import ADVERSARY, OUTCOME_COLOURS
from mast_zenoh.show.tables.scores import score_table

COLOURS = OUTCOME_COLOURS | {"adversary": ADVERSARY}


def image_of(data: bytes) -> np.ndarray:
    return np.asarray(matplotlib.image.imread(io.BytesIO(data)))[..., :3]


def pixels(image: np.ndarray, colour: str) -> int:
    return int((np.abs(image - to_rgb(COLOURS[colour])) < 0.02).all(axis=-1).sum())


def panels(view: Frame) -> Mapping[str, np.ndarray]:
    """The insides of the bird's-eye figure's panels, without titles and key."""
    image = image_of(png(birdseye_figure(view)))
    third = image.shape[1] // 3
    return {
        name: image[46:480, 74 + third * place : third * (place + 1) - 12]
        for place, name in enumerate(("local", "picture", "mission"))
    }


def view_of(run: Run, frame: int = 33) -> Frame:
    return frame_view(run, frame)


@pytest.fixture
def attacked(run_of: Callable[..., Run]) -> Frame:
    return view_of(run_of("uncoordinated"))


@pytest.fixture
def clean(run_of: Callable[..., Run]) -> Frame:
    return view_of(run_of())


def test_false_tracks_and_insertions_are_absent_from_the_ego_alone_panel(attacked: Frame) -> None:
    drawn = panels(attacked)
    assert pixels(drawn["mission"], "track false") == pixels(drawn["picture"], "track false")
    assert pixels(drawn["picture"], "track false") > 250
    assert pixels(drawn["local"], "track false") == 0
    # The compromised sensors are marked in both panels, the inserted objects in the picture.
    assert pixels(drawn["picture"], "adversary") > pixels(drawn["local"], "adversary") + 300 > 300


def test_missed_and_matched_objects_are_drawn_in_both_panels(clean: Frame) -> None:
    drawn = panels(clean)
    for panel in drawn.values():
        assert pixels(panel, "truth missed") > 50
        assert pixels(panel, "truth matched") > 15
        assert pixels(panel, "track matched") > 50
        assert pixels(panel, "track false") == 0
        assert pixels(panel, "adversary") == 0
    assert pixels(drawn["local"], "truth missed") > pixels(drawn["picture"], "truth missed")


def test_unevaluated_objects_are_green(run_of: Callable[..., Run]) -> None:
    with_one, without = (panels(view_of(run_of(), frame))["local"] for frame in (27, 28))
    assert pixels(with_one, "unevaluated") > 30
    assert pixels(without, "unevaluated") == 0


def test_the_camera_sees_false_objects_ahead_in_the_picture_only(attacked: Frame) -> None:
    figure = camera_figure(attacked)
    image = image_of(png(figure))
    half = len(image) // 2
    assert pixels(image[:half], "track false") == 0
    assert pixels(image[half : half + 420], "track false") > 100


def test_runs_side_by_side_have_a_panel_each(attacked: Frame, clean: Frame) -> None:
    views = {"baseline": clean, "uncoordinated": attacked}
    table = score_table({label: view.run for label, view in views.items()})
    image = image_of(png(side_by_side_figure(views, table)))
    width = image.shape[1]
    plots = image[60:700]
    assert pixels(plots[:, : width // 2], "track false") == 0
    assert pixels(plots[:, width // 2 :], "track false") > 300


def test_the_legend_fits_into_a_figure_of_any_width_and_says_how_high_it_is(attacked: Frame) -> None:
    entries = legend_entries([attacked], THEMES["light"])
    heights = []
    for width in (14.0, 8.0, 3.4):
        figure = Figure(figsize=(width, 4.0))
        heights.append(draw_legend(figure, entries, THEMES["light"], 9.0))
        (legend,) = figure.legends
        drawn = legend.get_window_extent()
        assert figure.bbox.x0 <= drawn.x0 < drawn.x1 <= figure.bbox.x1
        assert drawn.height / figure.dpi == pytest.approx(heights[-1])
        assert len(legend.get_texts()) == len(entries)
    assert heights == sorted(heights)
    assert heights[2] > 2 * heights[0]


def test_arrows_are_in_the_legend_of_the_view_from_above_alone(attacked: Frame) -> None:
    attacked.run.files.effects["effect"] = np.full(len(attacked.run.files.effects["frame"]), "moved")
    view = view_of(attacked.run.with_())
    above, ahead = ([entry.get_label() for entry in legend_entries([view], THEMES["dark"], camera=camera)]
                    for camera in (False, True))  # fmt: skip
    assert "moved by adversary" in above
    assert "roadside sensor" in above
    assert set(above) - set(ahead) == {"moved by adversary", "roadside sensor", "vehicle with sensors",
                                       "adversary on its wire"}  # fmt: skip


def test_four_or_more_runs_use_more_rows(clean: Frame) -> None:
    table = score_table({"a": clean.run})
    three = side_by_side_figure(dict.fromkeys("abc", clean), table)
    seven = side_by_side_figure(dict.fromkeys("abcdefg", clean), table)
    assert seven.get_figheight() > 2.5 * three.get_figheight()
    assert len(seven.axes) == 7


def test_counts_are_drawn_from_any_number_of_frames(run_of: Callable[..., Run]) -> None:
    run = run_of()
    few = {name: column[:2] for name, column in run.files.counts.items()}
    figure = counts_over_time({"run": run.with_(counts=few)}, 0)
    assert len(png(figure)) > 5000


def test_smoothed_lines_do_not_rise_before_the_attack(run_of: Callable[..., Run]) -> None:
    figure = counts_over_time({"run": run_of("uncoordinated")}, None)
    bold = next(line for line in figure.axes[1].get_lines() if line.get_label() == "picture")
    time, false = bold.get_xdata(), bold.get_ydata()
    assert false[time < 1.45].max() == 0.0
    assert false[-1] == 10.0


def eye() -> Eye:
    return Eye(Camera(), np.zeros(3), rotation_from_yaw(0.0))


def test_lines_are_clipped_at_the_near_plane() -> None:
    ahead, behind, through = [[10, 1, 1], [20, 1, 1]], [[-10, 1, 1], [-20, 1, 1]], [[-10, 1, 1], [10, 1, 1]]
    drawn = [eye().visible(np.array(line, float)) for line in (ahead, behind, through)]
    assert [len(line) > 0 for line in drawn] == [True, False, True]
    assert drawn[0][0] == pytest.approx([400 - 40, 300 + 24])
    assert np.isfinite(drawn[2]).all()
    assert any(point == pytest.approx([400 - 40, 300 + 24]) for point in drawn[2])


_PLACE = st.tuples(*[st.floats(-40.0, 40.0)] * 3)


@given(st.lists(_PLACE, min_size=3, max_size=3, unique=True), st.tuples(*[st.floats(0.05, 1.0)] * 2))
def test_what_is_clipped_lies_in_front_and_the_rest_is_unchanged(
    corners: list[tuple[float, ...]], sides: tuple[float, float]
) -> None:
    first, second, third = np.array(corners)
    face = np.array([first, second, third, first + sides[0] * (third - second)])  # plane and convex
    depth = face[:, 0] - 0.5
    clipped = clip_polygon(face, depth)
    if (depth >= 0.0).all():
        assert clipped is face
        return
    assert (clipped[:, 0] >= 0.5 - 1e-9).all()
    assert len(clipped) <= len(face) + 1
    assert (len(clipped) > 0) == (depth >= 0.0).any()
    kept = face[depth >= 0.0]
    assert all((clipped == corner).all(axis=1).any() for corner in kept)
    new = clipped[~(clipped[:, None] == face[None]).all(axis=2).any(axis=1)]
    assert new[:, 0] == pytest.approx(0.5), "new corners lie on the plane"
    low, high = face.min(axis=0) - 1e-9, face.max(axis=0) + 1e-9
    assert ((clipped >= low) & (clipped <= high)).all()
