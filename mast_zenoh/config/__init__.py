"""Turns user input into objects: loads files, finds classes, applies settings."""
