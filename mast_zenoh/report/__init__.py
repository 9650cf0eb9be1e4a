"""Figures, tables and the HTML report of a run or of several runs compared."""

from mast_zenoh.report.html import write_report, write_study_report
from mast_zenoh.report.table import ScoreTable, as_markdown, as_rich, score_table

__all__ = ["ScoreTable", "as_markdown", "as_rich", "score_table", "write_report", "write_study_report"]
