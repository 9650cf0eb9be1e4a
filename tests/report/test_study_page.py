"""The study page is self-contained and escaped, with failures first."""

from pathlib import Path

import pytest
from kept_texts import assert_kept, visible
from parsed_page import Page
from study_samples import BASELINE, facts, grid

from mast_zenoh.metrics.study_results import FailedTrial
from mast_zenoh.show.figures.study import figures_over_trials
from mast_zenoh.show.html import write_trials_page
from mast_zenoh.show.tables.text_table import TextTable

pytestmark = pytest.mark.usefixtures("unpainted")

ROWS = [BASELINE, *grid("uncoordinated", n=(1, 2), false_positives=(1.0, 5.0, 20.0))]
FAILED = [
    FailedTrial(
        "uncoordinated-1-5.0", "intersection:1", seed, "RunError: <b>bold</b> failure", f"mast run x --seed {seed}"
    )
    for seed in range(12)
]


def test_the_words_of_a_page_of_a_study_with_failed_trials(tmp_path: Path) -> None:
    known = facts(ROWS, FAILED)
    file = write_trials_page(tmp_path, ROWS, known, figures_over_trials(ROWS, known))
    assert_kept("page_of_a_study", visible(file))
    page = Page(file)
    assert page.source.index('role="alert"') < page.source.index("<figure")
    assert page.text.count("RunError: <b>bold</b> failure") == len(FAILED)
    assert "b" not in page.tags


def test_the_headline_of_a_study_of_driven_cars_comes_before_the_errors_and_own_tables_after_it(tmp_path: Path) -> None:
    own = TextTable("Lies", "Of each trial.", ("architecture", "added by lies"), [["centre", "2.00 [1.00, 3.00]"]], 1)
    words = ("the ego hits more", ["It hits.", "A veto helps."])
    assert_kept("page_of_a_driving_study", visible(write_trials_page(tmp_path, ROWS, facts(ROWS), {}, [own], *words)))
