"""Nodes that live elsewhere; see beside.py for an elsewhere that is here."""
