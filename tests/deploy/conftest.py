"""Nodes that live elsewhere; see launched_apart.py for an elsewhere that is here."""
