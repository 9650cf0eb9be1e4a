"""The figures of reports and of studies. All that draws is in here."""

from mast_zenoh.report.figures import backend  # noqa: F401  # first: imports Matplotlib
