"""Pages on a screen of 500 px and on paper: nothing is cut off, and scores are visible without scrolling."""

from dataclasses import replace
from pathlib import Path

import pytest
from browser import chromium
from study_samples import BASELINE, estimate, facts, row

from mast_zenoh.metrics.study_results import StudySeries
from mast_zenoh.show.html import write_study_report, write_trials_page

_SCORES = """() => [...document.querySelectorAll("table.scores")].map(
    (table) => [table.parentElement.scrollWidth, table.parentElement.clientWidth])"""
_RIGHT_ENDS = """() => [...document.querySelectorAll("section.run figure.dark.wide")].map((figure) => {
    const image = figure.querySelector("img").getBoundingClientRect();
    return [image.right, figure.getBoundingClientRect().right];
})"""


@pytest.mark.heavy
def test_a_study_fits_500_px_and_paper(three_runs: dict[str, Path], tmp_path: Path) -> None:
    page_file = write_study_report(tmp_path, three_runs)
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 500, "height": 900})
        page.goto(page_file.as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") == 500
        [(needed, available)] = page.evaluate(_SCORES)
        assert needed <= available, "every column of the scores is visible"
        ends = page.evaluate(_RIGHT_ENDS)
        assert len(ends) == 3
        assert all(abs(image - figure) < 2 for image, figure in ends), "the panel with the result is visible"
        page.close()
        paper = browser.new_page(viewport={"width": 718, "height": 1000})  # of A4, at 96 pixels per inch
        paper.emulate_media(media="print")
        for file in (page_file, three_runs["uncoordinated"] / "report.html"):
            paper.goto(file.as_uri())
            assert paper.evaluate("document.documentElement.scrollWidth") == 718, f"{file} is cut off in print"
        paper.close()


@pytest.mark.heavy
def test_a_study_with_many_files_and_achievements_fits_500_px_and_paper(tmp_path: Path) -> None:
    achieved = {StudySeries("all", "achieved", f"share_of_number_{number}"): estimate(0.5) for number in range(24)}
    scores = {
        StudySeries("", estimator, metric): estimate(12.34)
        for estimator in ("local", "picture", "mission")
        for metric in ("fn", "fp", "tp", "rmse_m", "id_switches")
    }
    attacked = row("attacked", {"adversaries": 2, "defence": "SequentialConsistency", "kind": "poles"}, 1.0)
    rows = [BASELINE, replace(attacked, numbers={**attacked.numbers, **achieved, **scores})]
    for name in ("results.parquet", "frames.parquet", "table.csv", "table.md", "table.tex", "increments.pdf"):
        (tmp_path / name).touch()
    page_file = write_trials_page(tmp_path, rows, facts(rows), {})
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 500, "height": 900})
        page.goto(page_file.as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") == 500
        paper = browser.new_page(viewport={"width": 718, "height": 1000})
        paper.emulate_media(media="print")
        paper.goto(page_file.as_uri())
        assert paper.evaluate("document.documentElement.scrollWidth") == 718
