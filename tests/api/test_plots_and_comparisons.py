"""Plots equal the report's figures; comparisons equal its tables and sentences."""

import io
import shutil
from pathlib import Path

import pytest
from PIL import Image

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError, NotComparable, RunFolderError


def displayed_image(figure: object) -> Image.Image:
    """The image that a notebook displays for a figure."""
    return Image.open(io.BytesIO(figure._repr_png_()))  # type: ignore[attr-defined]


def test_a_notebook_displays_the_figures_of_the_report_which_may_compare_two_runs(
    attacked: mast.Run, baseline: mast.Run, tmp_path: Path
) -> None:
    run = mast.open(shutil.copytree(attacked.path, tmp_path / "run"))
    page = run.report(frame=40)
    for name in ("over_time", "birdseye", "camera", "driving", "wiring"):
        options = {"frame": 40} if name in ("birdseye", "camera") else {}
        image = displayed_image(getattr(run.plot, name)(**options))
        ours = Image.open(run.path / "figures" / f"{'counts' if name == 'over_time' else name}.png")
        assert image.size == ours.size
        if name not in ("over_time", "driving"):  # in these the report marks the frame that it shows
            assert image.tobytes() == ours.tobytes()
    assert run.report(frame=40, against=baseline) == page == (tmp_path / "run" / "report.html").resolve()
    assert "compared with baseline" in page.read_text()


def test_one_metric_of_two_runs_over_time_is_one_chart_with_two_lines(
    attacked: mast.Run, baseline: mast.Run, tmp_path: Path
) -> None:
    figure = attacked.plot.over_time("fp", baseline)
    (axes,) = figure.axes
    assert "false objects" in axes.get_ylabel()
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"attack", "ego alone", "picture, uncoordinated", "picture, baseline"} == set(legend)
    lines = {line.get_label(): line.get_ydata() for line in axes.get_lines()}
    assert lines["picture, uncoordinated"].max() > lines["picture, baseline"].max()
    for metric in ("fn", "tp", "rmse_m", "id_switches", "ospa_m", "gospa_m"):
        assert len(attacked.plot.over_time(metric).axes) == 1
    shutil.copytree(attacked.path, tmp_path / "again")
    figure = attacked.plot.over_time("fp", mast.open(tmp_path / "again"))
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"picture, uncoordinated", "picture, again"} <= set(legend), "of equal names, the folder tells them apart"


def test_unknown_or_empty_series_are_refused(attacked: mast.Run) -> None:
    with pytest.raises(ConfigurationError, match="mean 'fp'"):
        attacked.plot.over_time("fpp")
    with pytest.raises(ConfigurationError, match="mean 'mission'"):
        attacked.plot.over_time("fp", estimate="misson")
    with pytest.raises(RunFolderError, match=r"frame 99.*0"):
        attacked.plot.birdseye(frame=99)
    with pytest.raises(RunFolderError, match=r"runs.*links.*faults"):
        attacked.plot.causes()


def test_a_comparison_lists_the_scores_and_differences_of_both_runs(attacked: mast.Run, baseline: mast.Run) -> None:
    comparison = mast.compare(baseline, attacked)
    rows = {(row["metric"], row["run"], row["estimate"]): row for row in comparison.table.to_pylist()}
    false = rows["fp", "uncoordinated", "picture"]
    assert false["mean"] == pytest.approx(attacked.summary["agents"]["ego"]["picture"]["fp"]["mean"])
    assert false["change"] == pytest.approx(false["mean"] - rows["fp", "baseline", "picture"]["mean"])
    assert false["change"] > 0.5
    assert [line.partition(":")[0] for line in comparison.headline.splitlines()] == ["baseline", "uncoordinated"]
    assert "more false objects" in comparison.headline
    assert "(+" in str(comparison)
    assert comparison.headline in str(comparison)
    assert "false (FP)" in comparison._repr_html_()
    assert comparison.markdown().startswith("| metric | run |")
    assert "baseline, uncoordinated" in repr(comparison)
    assert len(comparison.plot.side_by_side(frame=40).axes) == 2


def test_runs_of_different_scenes_cannot_be_compared(attacked: mast.Run, tmp_path: Path) -> None:
    other = mast.run("baseline", n_infrastructure=2, frames=60, seed=4, out=tmp_path / "run")
    with pytest.raises(NotComparable, match="seed 4"):
        mast.compare(other, attacked)
    with pytest.raises(ConfigurationError, match="two or more"):
        mast.compare(attacked)
