"""The first missing message of a recording is found from the recording itself."""

from __future__ import annotations

from pathlib import Path

import pytest
from recordings import TAP, small_run, write

from mast_zenoh.messagelog.reader import first_missing_frame, read


def without(path: Path, *missing: tuple[str, int]) -> Path:
    """A recording of the small run without some messages, each as (key, frame)."""
    keys = [(key, number // 5) for number, (key, _) in enumerate(small_run())]
    return write(path, [sent for at, sent in zip(keys, small_run(), strict=True) if at not in missing])


@pytest.mark.parametrize(
    ("missing", "first"),
    [
        ((), None),
        ((("clock", 3),), 3),
        ((("clock", 0),), 0),
        ((("clock", 4), ("agent/b/detections", 2), (TAP, 2)), 2),
        ((("agent/b/detections", 2),), None),  # an interposer dropped it: it was heard before the interposer
        ((("clock", 5),), None),  # nothing indicates that there was one more
        ((("agent/a/status", 3),), None),  # of another publisher
    ],
)
def test_a_gap_in_a_publishers_sequence_is_found(
    tmp_path: Path, missing: tuple[tuple[str, int], ...], first: int | None
) -> None:
    assert first_missing_frame(without(tmp_path / "run.mcap", *missing), "simulator") == first


def test_an_unreadable_recording_may_lack_everything(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"no recording")
    assert first_missing_frame(tmp_path / "run.mcap", "simulator") == 0
    assert len(list(read(without(tmp_path / "whole.mcap")))) == len(small_run())
