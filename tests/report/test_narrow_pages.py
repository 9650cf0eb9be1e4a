"""Pages on a screen of 500 px and on paper: nothing is cut off, and scores are visible without scrolling."""

from __future__ import annotations

from pathlib import Path

from browser import chromium

from mast_zenoh.report.html import write_study_report

_SCORES = """() => [...document.querySelectorAll("table.scores")].map(
    (table) => [table.parentElement.scrollWidth, table.parentElement.clientWidth])"""
_RIGHT_ENDS = """() => [...document.querySelectorAll("section.run figure.dark.wide")].map((figure) => {
    const image = figure.querySelector("img").getBoundingClientRect();
    return [image.right, figure.getBoundingClientRect().right];
})"""


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
