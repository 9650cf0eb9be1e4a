"""Only parts of shipped scenarios that take part in nothing are said to."""

from __future__ import annotations

import json
from collections.abc import Callable

from observed_run import ObservedRun
from played import Played

#: What is so in the first 3.6 s: the ego never sees the object that its adversary is to hide.
IDLE = {
    "hide_object": ["adversary_0 on agent/ego/tracks changed no message"],
    "sybil": ["faults[0] (Join) begins at 12 s, after the last frame (3.5 s)"],
}


def test_no_part_of_a_shipped_scenario_is_idle_by_mistake(
    variant: tuple[str, ...], shipped: Callable[[tuple[str, ...]], tuple[Played, ObservedRun]]
) -> None:
    record = json.loads((shipped(variant)[0].folder / "run.json").read_text())
    assert [notice["text"] for notice in record["notices"] if notice["kind"] == "idle"] == IDLE.get(variant[0], [])
