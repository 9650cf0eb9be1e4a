"""tools/results.py makes the pages of docs/results/, and finds numbers that differ by more than chance."""

import csv
import re
from pathlib import Path

import pytest
import results
from results_pages import PAGES, Page, Part

from mast_zenoh.show.tables.text_table import TextTable
from mast_zenoh.study import definition

PARTS = [(page, part) for page in PAGES for part in page.parts if isinstance(part, Part)]
#: The largest figure that a page may have, bytes.
LARGEST = 150_000


def loaded(part: Part, *, quick: bool) -> definition.Study:
    chosen = dict(part.quick if quick else part.full) | dict(part.paths)
    return definition.load_values(part.study, {name: chosen[name] for name in {*chosen} - {*results.OPTIONS}})


@pytest.mark.parametrize(("page", "part"), PARTS, ids=[f"{page.name}-{part.study}" for page, part in PARTS])
def test_a_quick_study_measures_what_the_full_one_does(page: Page, part: Part) -> None:
    quick, full = loaded(part, quick=True), loaded(part, quick=False)
    of_full = {each.label: each.settings for each in full.configurations}
    assert {each.label: each.settings for each in quick.configurations}.items() <= of_full.items()
    assert {each.label for each in quick.scenes} <= {each.label for each in full.scenes}
    assert part.quick.get("frames", quick.frames) == part.full.get("frames", full.frames)
    assert bool(part.table) != bool(part.columns)


def test_names_of_pages_and_of_their_parts_are_unique() -> None:
    assert len({page.name for page in PAGES}) == len(PAGES)
    for page in PAGES:
        assert len({part.title for part in page.parts}) == len(page.parts)


def numbers(file: Path, *lines: tuple[str, float, float, float]) -> Path:
    rows = [("attacks", name, "fp", value, low, high, "Student's t", 5) for name, value, low, high in lines]
    with file.open("w", newline="") as text:
        csv.writer(text).writerows([results.COLUMNS, *rows])
    return file


def test_only_numbers_beyond_both_intervals_are_outside(tmp_path: Path) -> None:
    full = numbers(tmp_path / "full.csv", ("a", 2.0, 1.9, 2.1), ("b", 2.0, 1.9, 2.1), ("c", 0.0, float("nan"), 0.0))
    quick = numbers(tmp_path / "quick.csv", ("a", 3.0, 1.5, 4.5), ("b", 3.0, 2.5, 3.5), ("c", 1.0, 0.9, 1.1))
    differing, compared, most = results.outside(quick, full)
    assert [line.split()[1] for line in differing] == ["b"]
    assert (compared, most) == (2, 2)


def test_a_page_has_its_question_sentences_table_command_and_origin(tmp_path: Path) -> None:
    table = TextTable("Attacks", "About.", ["", "false"], [["Flood", "3.00 [2.00, 4.00]"]])
    line = dict.fromkeys(results.COLUMNS, "") | {"study": "attacks", "of": "Flood", "measure": "fp", "value": 3.0}
    part = results.Played(
        "Attacks", ["Flood adds most."], table, [line], "mast study attacks --trials 5", seeds="0 to 4"
    )
    results.write(PAGES[0], [part], tmp_path, quick=True)
    page = (tmp_path / "attacks.md").read_text("utf-8")
    for content in (PAGES[0].question, "Flood adds most.", "| Flood | 3.00 [2.00, 4.00] |", part.command, "0 to 4"):
        assert content in page
    assert re.search(r"\| commit \| \w{7,}", page)
    assert (tmp_path / "attacks.csv").read_text("utf-8").splitlines()[1].startswith("attacks,Flood,fp,3.0")


def test_without_its_data_a_page_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MAST_DATA", str(tmp_path))
    results.main(["real-data", "--quick", "--out", str(tmp_path)])
    assert "real-data: not made" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.heavy
@pytest.mark.timeout(3600)
def test_all_pages_are_made_quickly_and_agree_with_those_that_are_kept(tmp_path: Path) -> None:
    assert results.main(["--quick", "--out", str(tmp_path)]) == 0
    made = {path.stem for path in tmp_path.glob("*.md")}
    assert made | {"real-data"} == {page.name for page in PAGES}
    for name in made:
        kept = results.FOLDER / f"{name}.md"
        headings = [
            re.findall(r"^##? .*$", page.read_text("utf-8"), re.MULTILINE) for page in (kept, tmp_path / f"{name}.md")
        ]
        assert headings[0] == headings[1], name
        differing, compared, most = results.outside(tmp_path / f"{name}.csv", results.FOLDER / f"{name}.csv")
        assert compared or name == "speed", name
        assert len(differing) <= most, "\n".join(differing)
    for figure in tmp_path.glob("*.png"):
        assert figure.stat().st_size <= LARGEST, figure.name
