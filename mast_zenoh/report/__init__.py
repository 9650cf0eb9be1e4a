"""Figures, tables and the HTML report of a run or of several runs compared."""

from mast_zenoh.report.html import write_report, write_study_report
from mast_zenoh.report.table import SummaryRow, as_markdown, as_rich, summary_table

__all__ = ["SummaryRow", "as_markdown", "as_rich", "summary_table", "write_report", "write_study_report"]
