"""Geometry, object states, matching and neighbour search on plain arrays."""
