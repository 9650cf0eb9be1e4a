"""The figures of reports and of studies."""
