"""The study page is self-contained and escaped, with failures first."""

from __future__ import annotations

from pathlib import Path

import pytest
from parsed_page import Page
from study_samples import BASELINE, facts, grid

from mast_zenoh.metrics.study_results import FailedTrial
from mast_zenoh.report.figures.study import figures_over_trials
from mast_zenoh.report.html import write_trials_page
from mast_zenoh.report.tables.text_table import TextTable

ROWS = [BASELINE, *grid("uncoordinated", n=(1, 2), false_positives=(1.0, 5.0, 20.0))]
FAILED = [
    FailedTrial(
        "uncoordinated-1-5.0", "intersection:1", seed, "RunError: <b>bold</b> failure", f"mast run x --seed {seed}"
    )
    for seed in range(12)
]


@pytest.fixture
def page(tmp_path: Path):
    def write(failed=()) -> Page:
        study_facts = facts(ROWS, failed)
        return Page(write_trials_page(tmp_path, ROWS, study_facts, figures_over_trials(ROWS, study_facts)))

    return write


def test_page_shows_result_configurations_and_number_of_comparisons(page) -> None:
    text = "".join(page().text.split())
    for part in (
        "The clearest change: in uncoordinated n=2 "
        "false_positives=1.0 the ego with the picture has 6.00 more false objects a frame",
        "7 configurations 20 seeds \u00d7 3 scenes seeds 0 to 19 420 trials 150 frames each runtime inproc",
        "30 comparisons with the baseline",
        "(Bonferroni)",
        "* marks the 18 that remain distinguishable from 0 after Holm's procedure",
        "6.00* [5.50, 6.50]",
        "What the attack adds: ego with the picture",
        "code 0123abcd",
        "60 of 60",
        "intersection:0; intersection:1; intersection:2",
    ):
        assert part.replace(" ", "") in text, part
    assert "trialsfailed" not in text


def test_failed_trials_are_listed_first_with_seed_error_and_command(page) -> None:
    parsed = page(FAILED)
    assert parsed.source.index('role="alert"') < parsed.source.index("<figure")
    assert "12 of 420 trials failed: uncoordinated n=1 false_positives=5.0 12 of 60." in parsed.text
    for trial in FAILED:
        assert trial.command in parsed.text
        assert f"seed {trial.seed}: " in parsed.text
    assert parsed.text.count("RunError: <b>bold</b> failure") == 12
    assert "b" not in parsed.tags
    assert "2 more" in parsed.text, "only the first ten are listed openly"
    assert "48 of 60" in parsed.text


def test_the_tables_of_a_study_of_defences_are_on_the_page(tmp_path: Path) -> None:
    own = TextTable("Lies", "Of each trial.", ("architecture", "added by lies"), [["centre", "2.00 [1.00, 3.00]"]], 1)
    page = Page(write_trials_page(tmp_path, ROWS, facts(ROWS), {}, [own]))
    for text in ("Lies", "Of each trial.", "architecture", "centre", "2.00 [1.00, 3.00]"):
        assert text in page.text


def test_the_headline_of_a_study_of_driven_cars_comes_before_the_errors(tmp_path: Path) -> None:
    usual = Page(write_trials_page(tmp_path, ROWS, facts(ROWS), {})).source
    errors = usual.partition("<h1>")[2].partition("</h1>")[0]
    page = Page(
        write_trials_page(tmp_path, ROWS, facts(ROWS), {}, (), "the ego hits more", ["It hits.", "A veto helps."])
    )
    assert "<h1>The ego hits more</h1>" in page.source
    assert '<p class="lead">It hits. A veto helps.</p>' in page.source
    before, _, after = page.source.partition('<h2 id="added">')
    assert errors not in before
    assert f"<p>{errors}." in after
