"""Reads text, JSON and XML strictly: each value with its place in the file, within limits."""
