"""Two runs are equal: every message, and the metrics."""

from __future__ import annotations

import json
from pathlib import Path

from mast_zenoh.messagelog.difference import compare, explain


def assert_equal(here: Path, there: Path, *, taps: bool = True, metrics: bool = True) -> None:
    """Assert that two run folders hold the same messages, at least one, and the same metrics.json."""
    difference = compare(here, there, taps=taps)
    assert difference.first is None, "\n".join(explain(difference))
    assert difference.equal > 0
    if metrics:
        assert json.loads((here / "metrics.json").read_text()) == json.loads((there / "metrics.json").read_text())
