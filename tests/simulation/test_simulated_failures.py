"""Failed handlers in simulated runs are reported exactly as in one process, with many interleavings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import failing
import pytest
from simulated_runs import harmless_schedules, on_simulated_mesh, resolve

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.runtime.inproc import InProcess


def failures_in_one_process(resolved: Resolved) -> dict[str, Any]:
    """The failures of handlers, by node."""
    run = InProcess(resolved)
    run.run()
    return run.failures()


@pytest.mark.parametrize(
    ("name", "node", "handler", "counts"),
    [
        ("center", "command_center", "on_collated", (4, 4, 2, 11)),
        ("evaluator", "evaluator", "finish", (1, 1, 11, 11)),
    ],
)
def test_failures_of_handlers_equal_those_in_one_process(
    name: str, node: str, handler: str, counts: tuple[int, ...], tmp_path: Path
) -> None:
    path = str(failing.write(name, tmp_path))
    expected = failures_in_one_process(resolve(path, frames=12, recorded=False))
    (entry,) = expected[node]
    assert entry["handler"] == handler
    assert tuple(entry[each] for each in ("count", "frames", "first_frame", "last_frame")) == counts
    resolved = resolve(path, frames=12)
    for schedule in harmless_schedules(resolved, 3):
        _, outcome = on_simulated_mesh(resolved, schedule)
        assert (outcome.error, outcome.frames, outcome.lost) == ("", 12, {}), "a run continues despite failures"
        assert outcome.failures == expected, schedule
        matching = [note for note in outcome.notes if f"{node}.{handler} failed once" in note]
        assert len(matching) == 1, "the first failure of a handler is shown"


def test_failures_in_a_handler_that_completes_a_frame_are_all_counted(tmp_path: Path) -> None:
    """An attack begins when the last of a frame's messages arrives: detections or a pose, as the mesh delivers them."""
    resolved = resolve(str(failing.write("attack", tmp_path)), frames=12)
    for schedule in harmless_schedules(resolved, 4):
        _, outcome = on_simulated_mesh(resolved, schedule)
        assert (outcome.error, outcome.frames, outcome.lost) == ("", 12, {}), schedule
        entries = outcome.failures.pop("eve")
        assert outcome.failures == {}, schedule
        assert {entry["handler"] for entry in entries} <= {"on_detections", "on_pose"}, schedule
        assert all(entry["exception"].startswith("ValueError: no [plan] for frame ") for entry in entries), schedule
        assert sum(entry["count"] for entry in entries) == sum(entry["frames"] for entry in entries) == 7, schedule
        assert min(entry["first_frame"] for entry in entries) == 5, schedule
        assert max(entry["last_frame"] for entry in entries) == 11, schedule
        matching = [
            note for note in outcome.notes if " failed once in frame " in note and "no \\[plan] for frame" in note
        ]
        assert len(matching) == len(entries), "the first failure of each handler is shown"
