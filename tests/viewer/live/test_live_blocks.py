"""Frames of running runs become blocks for the page."""

from __future__ import annotations

from typing import Any

import pytest
from recorded_observer import NUMBERS, RecordedObserver

import mast_zenoh as mast
from mast_zenoh.viewer.page.live_view import LASTING, LiveBlocks


@pytest.mark.parametrize("has_scene", [True, False])
def test_a_frame_is_shown_with_and_without_a_prepared_scene(recorded: mast.Run, has_scene: bool) -> None:
    observer: Any = RecordedObserver(recorded.path, has_scene=has_scene)
    blocks = LiveBlocks.of(observer)
    sizes = []
    while not observer.is_over():
        if (frame := observer.advance()) is not None:
            lasting, block = blocks.header_and_block(frame)
            assert {*lasting} == {*LASTING}
            assert bool(lasting["agents"]) is has_scene
            assert bool(lasting["tops"]) is has_scene
            sizes.append((frame.index, len(block)))
    assert [number for number, _ in sizes] == list(NUMBERS)
    assert min(size for _, size in sizes) > 500, "with objects"
