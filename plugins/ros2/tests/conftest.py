"""Fixtures that the tests of the viewer have, too: a recorded run."""

from tests.viewer.conftest import exported_to, out, record, recorded

__all__ = ["exported_to", "out", "record", "recorded"]
