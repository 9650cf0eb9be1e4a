"""Checks of a finished run by its record."""
