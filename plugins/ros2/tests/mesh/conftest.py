"""Fixtures of the package's tests on a real mesh."""

from tests.mesh.conftest import launch, nothing_is_left_behind

__all__ = ["launch", "nothing_is_left_behind"]
