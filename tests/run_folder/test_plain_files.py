"""Only plain files of a run folder are read, whatever their format: no links, pipes, sockets or folders."""

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh import scene
from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder import check_plain, open_plain, read_json
from mast_zenoh.run_folder.recording.reader import file_of
from mast_zenoh.run_folder.recording.script import Script
from mast_zenoh.run_folder.tables import TableFile, read_table
from mast_zenoh.scenario import load, resolve
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.scenes.recording_file import RecordingFile

READERS = [read_json, read_table, Recording.load, Recording.open, Script.load, check_plain, open_plain]
READERS += [lambda path: TableFile(path).rows(["frame"])]


def link(path: Path) -> None:
    (path.parent / "target").write_bytes(b"{}")
    path.symlink_to("target")


def bind(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(os.path.relpath(path))


KINDS = {
    "a link": link,
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a special file": bind,
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", KINDS)
def test_every_reader_refuses_what_is_no_plain_file_and_names_it(
    kind: str, reader: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    path = tmp_path / "a_file"
    KINDS[kind](path)
    with pytest.raises(RunFolderError, match=f"{path}.*{kind}.*file"):
        reader(path)


def test_a_missing_file_is_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        check_plain(tmp_path / "nowhere")


def test_the_recording_of_a_run_folder_is_no_link_and_one_that_the_user_names_may_be_one(tmp_path: Path) -> None:
    link(tmp_path / "messages.mcap")
    assert file_of(tmp_path / "messages.mcap") == tmp_path / "messages.mcap"
    with pytest.raises(RunFolderError, match="link"):
        file_of(tmp_path)


def test_a_scene_that_the_user_names_may_be_a_link(tmp_path: Path) -> None:
    path, content = load("baseline")
    recording = resolve(path, content, frames=1).recording
    recording.save(tmp_path / "scene.npz")
    (tmp_path / "link.npz").symlink_to("scene.npz")
    assert len(RecordingFile(path=str(tmp_path / "link.npz")).record(0, None)) == 1
    assert scene(tmp_path / "link.npz").truth is not None
