"""Fixtures of the tests of control messages."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "nodes"))
