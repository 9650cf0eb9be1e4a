"""Turns what users write into objects: loads files, looks classes up by name, applies settings."""
