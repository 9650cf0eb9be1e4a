"""The disk cache of prepared scenes."""

import importlib
import os
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from mast_zenoh.errors import SceneError
from mast_zenoh.scenes import cache, prepare
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.cache import cache_folder
from mast_zenoh.scenes.making.sensor_types import Radar
from mast_zenoh.scenes.recording import Recording


class Counted(Scene):
    """A scene that counts how often it is recorded."""

    def __init__(self, recording: Recording, files: Sequence[Path] = ()) -> None:
        self.made = 0
        self._recording, self._files = recording, files

    def record(self, seed: int, frames: int | None) -> Recording:
        self.made += 1
        return self._recording

    def inputs(self) -> Sequence[Path]:
        return self._files


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return cache_folder()


def test_a_scene_is_recorded_once(recording: Recording) -> None:
    scene = Counted(recording)
    first, second = prepare(scene, 1, None, "a"), prepare(scene, 1, None, "a")
    assert scene.made == 1
    np.testing.assert_array_equal(first.truth.position, second.truth.position)


def test_error_in_a_users_scene_names_its_file_and_line_alone() -> None:
    scene = Counted(None)  # type: ignore[arg-type]
    del scene.made
    with pytest.raises(SceneError, match=rf"^{re.escape(__file__)}:\d+: AttributeError: .*made") as raised:
        prepare(scene, 1, None, "a")
    cause = raised.value.__cause__
    assert isinstance(cause, AttributeError)
    assert cause.__context__ is None, "not of a cache without the scene"


def test_a_scene_that_returns_something_else_is_refused_and_not_cached(folder: Path) -> None:
    class Wrong(Scene):
        def record(self, seed: int, frames: int | None) -> Recording:
            return self  # type: ignore[return-value]

    Wrong.__module__ = "mast_zenoh.nowhere"  # such a class would be cached
    for _ in range(2):
        with pytest.raises(SceneError, match=r"Wrong.record.*Wrong.*Recording"):
            prepare(Wrong(), 0, None, "wrong")
    assert not list(folder.glob("*.npz"))


def test_seed_configuration_and_length_are_part_of_the_cache_key(recording: Recording) -> None:
    scene = Counted(recording)
    for seed, frames, key in ((1, None, "a"), (2, None, "a"), (1, 5, "a"), (1, None, "b")):
        prepare(scene, seed, frames, key)
    assert scene.made == 4


def test_without_a_key_nothing_is_cached(recording: Recording, folder: Path) -> None:
    scene = Counted(recording)
    prepare(scene, 1, None, None)
    prepare(scene, 1, None, None)
    assert scene.made == 2
    assert not folder.exists()


def test_a_broken_cache_file_is_recorded_again(recording: Recording, folder: Path) -> None:
    scene = Counted(recording)
    prepare(scene, 1, None, "a")
    (entry,) = folder.iterdir()
    entry.write_bytes(entry.read_bytes()[:1000])
    prepare(scene, 1, None, "a")
    prepare(scene, 1, None, "a")
    assert scene.made == 2
    assert list(folder.iterdir()) == [entry]


def test_changed_data_invalidate_a_prepared_scene(recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    file = tmp_path / "data" / "boxes.txt"
    file.write_text("one")
    scene = Counted(recording, (tmp_path / "data",))
    prepare(scene, 1, None, "a")
    file.write_text("three")
    prepare(scene, 1, None, "a")
    os.utime(file, ns=(0, 0))
    prepare(scene, 1, None, "a")
    assert scene.made == 3


def test_two_processes_may_prepare_a_scene_at_the_same_time(recording: Recording, folder: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: prepare(Counted(recording), 1, None, "a"), range(16)))
    assert all(len(each.truth) == 3 for each in made)
    assert len(list(folder.iterdir())) == 1


def test_an_unwritable_cache_is_not_an_error(recording: Recording, folder: Path) -> None:
    folder.parent.mkdir(parents=True)
    folder.write_text("a file where the folder should be")
    assert len(prepare(Counted(recording), 1, None, "a")) == 2


def test_the_cache_removes_least_recently_used_files(recording, folder, monkeypatch):
    scene = Counted(recording)
    prepare(scene, 1, None, "a")
    (first,) = folder.iterdir()
    size = first.stat().st_size
    monkeypatch.setattr(cache, "LIMIT", int(2.5 * size))
    os.utime(first, ns=(0, 0))
    prepare(scene, 2, None, "a")
    prepare(scene, 3, None, "a")
    assert first not in list(folder.iterdir())
    assert len(list(folder.iterdir())) == 2


def test_a_relative_cache_home_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "somewhere")
    assert cache_folder() == Path.home() / ".cache" / "mast-zenoh" / "scenes"


def test_changed_code_of_a_sensors_detector_invalidates_a_prepared_scene(recording, tmp_path, monkeypatch):
    """It is a part of a part of the scene."""
    file = tmp_path / "my_detector.py"
    file.write_text("from mast_zenoh.sensing import CleanDetector\n\n\nclass Mine(CleanDetector): ...\n")
    monkeypatch.syspath_prepend(tmp_path)
    scene = Counted(recording)
    scene.sensors = {"ego": (Radar(detector=importlib.import_module("my_detector").Mine()),)}
    prepare(scene, 0, None, "counted")
    prepare(scene, 0, None, "counted")
    assert scene.made == 1
    file.write_text(file.read_text() + "# changed\n")
    prepare(scene, 0, None, "counted")
    assert scene.made == 2
