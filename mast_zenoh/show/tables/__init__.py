"""Rows and cells of all tables of reports, for all output formats."""
