"""A long run opens at once, and in little memory: only what is asked for is read."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from long_run import SHORT_FRAMES, sparse

import mast_zenoh as mast
from mast_zenoh.config import loading
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.run_folder.tables import TableFile, read_table
from mast_zenoh.scenes import recording as recording_module
from mast_zenoh.scenes.recording import Recording

opening = loading.module(Path(__file__).parents[2] / "benchmarks" / "opening.py")


def test_frames_of_a_sparse_run_are_those_of_its_whole_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = 3 * SHORT_FRAMES
    folder = sparse(tmp_path / "run", frames, 4)
    run = mast.open(folder)
    assert run.status == "ok"
    assert run.agents == ("ego", "infra_1", "infra_2", "infra_3")
    assert "infra_1" in run.report().read_text("utf-8")
    assert [message.frame for message in read(folder)] == list(range(frames))
    for name in ("metrics", "objects", "attacks"):
        file, whole = TableFile(folder / f"{name}.parquet"), read_table(folder / f"{name}.parquet")
        first, last = int(whole["frame"].min()), int(whole["frame"].max())
        assert last == frames - 1
        for frame in (first, SHORT_FRAMES, last):
            rows = file.rows(list(whole), range(frame, frame + 1))
            assert len(rows["frame"]) > 0 or frame == SHORT_FRAMES
            for column, values in rows.items():
                np.testing.assert_array_equal(values, whole[column][whole["frame"] == frame])
    monkeypatch.setattr(recording_module, "MAPPED_BYTES", 0)
    opened, loaded = Recording.open(folder / "scene.npz"), Recording.load(folder / "scene.npz")
    assert len(loaded) == frames
    for frame in range(frames):
        np.testing.assert_array_equal(opened.truth_at(frame).position, loaded.truth_at(frame).position)
        np.testing.assert_array_equal(
            opened.detections_at(frame, 2).covariance, loaded.detections_at(frame, 2).covariance
        )


def test_a_report_with_a_scene_that_stays_in_its_file_equals_that_with_one_in_memory(
    recorded: mast.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = mast.open(shutil.copytree(recorded.path, tmp_path / "run"))
    in_memory = run.report().read_text("utf-8")
    monkeypatch.setattr(recording_module, "MAPPED_BYTES", 0)
    assert run.report().read_text("utf-8") == in_memory


@pytest.mark.heavy
@pytest.mark.timeout(600)  # a minute of writing
def test_a_run_of_10_000_frames_and_100_agents_opens_in_half_a_second_and_300_mb(tmp_path: Path) -> None:
    folder = sparse(tmp_path / "run", 10_000, 100)
    steps = opening.measure(folder, 5000)
    steps.pop("imports")
    assert sum(processor for _, processor, _ in steps.values()) < 0.5
    assert max(peak for _, _, peak in steps.values()) < 300
