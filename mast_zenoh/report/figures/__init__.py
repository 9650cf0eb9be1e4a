"""The figures of reports and of studies. All drawing code is here."""

from mast_zenoh.report.figures import backend  # noqa: F401  # first: imports Matplotlib
