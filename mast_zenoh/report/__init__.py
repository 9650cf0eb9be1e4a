"""Tables, figures and pages of one run or of compared runs.

See docs/report.md and docs/studies.md.

runfolder, files   contents of a run folder
comparison         the reference run of a comparison
figures/           the pictures and charts of runs and of studies
tables/            rows and cells, for every output
narrative/         results in words
html, study_page   the pages, which page renders from templates/
fault_tables       tables for links, faults and the wall clock
terminal           results on the terminal
study_facts        configurations, seeds and failed trials of a study
"""

from mast_zenoh.report.figures import backend  # noqa: F401  # first: imports Matplotlib
from mast_zenoh.report.html import write_report, write_study_report
from mast_zenoh.report.tables.scores import ScoreTable, as_markdown, as_rich, score_table

__all__ = ["ScoreTable", "as_markdown", "as_rich", "score_table", "write_report", "write_study_report"]
