"""Fixtures of the tests of the launcher, which play in the tiny world of the tests of the nodes."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "nodes"))

from tiny_world import own_cache  # noqa: F401
