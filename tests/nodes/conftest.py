"""Fixtures of the tests of the nodes."""

from tiny_world import own_cache  # noqa: F401
