"""Run folders from an attacker: no command runs their code, writes outside them, hangs, or shows a traceback."""

import hashlib
import os
import shutil
import signal
import struct
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType

import numpy as np
import pyarrow
import pytest
import zstandard
from commands_in_process import Ended, command
from hostile_folders import CASES, COMMANDS, Case, Place, wrong_types
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from measured_process import measure
from pyarrow import parquet

import mast_zenoh as mast
from mast_zenoh import errors
from mast_zenoh.cli import observers
from mast_zenoh.errors import MastError, UntrustedCode
from mast_zenoh.show.figures import drawing
from mast_zenoh.show.page.live_server import PageServer

pytestmark = [pytest.mark.heavy, pytest.mark.long]

ALL = CASES | dict(wrong_types())
MAX_S = 20
MAX_PEAK_BYTES = 1 << 30
KNOWN_CODES = {0, 1, 2} | {
    kind.exit_code for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, MastError)
}
#: Commands that could do what these kinds of cases want.
RUNNING = ("report measured", "report against twin", "replay", "intercept", "deploy down", "view")
WRITING = ("report", "report measured", "replay", "export", "export pcap")


def commands_of(name: str, *, every: bool) -> list[str]:
    """The commands that read a case; by default one of them in turn, and those that could do what it wants."""
    if every:
        return list(COMMANDS)
    chosen = [list(COMMANDS)[list(ALL).index(name) % len(COMMANDS)]]
    if name.startswith(("module_outside", "file_of_", "relative", "node_files", "a_folder", "dotted", "files_as")):
        chosen += RUNNING
    if name.startswith(("engine", "host", "running")):
        chosen += ["view", "intercept", "release", "deploy status", "deploy down"]
    if name.startswith(("link_report", "link_metrics", "linked_folder", "results_to", "name_of", "recording_of")):
        chosen += WRITING
    if name.startswith(("names_in_the_recording", "link_messages", "wiring_", "list_as_wiring", "nothing_in_wiring")):
        chosen += ["export pcap"]
    return list(dict.fromkeys(chosen))


@contextmanager
def limited_to(seconds: int) -> Iterator[None]:
    """Raise TimeoutError in a block that takes longer, such as in a file that never ends."""

    def expired(_number: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"not finished after {seconds} s")

    before = signal.signal(signal.SIGALRM, expired)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def contents(folder: Path) -> dict[str, str]:
    """All files and folders below one, with a digest of each file."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "folder"
        for path in folder.rglob("*")
    }


def spoilt(sound: Path, top: Path, spoil: Case) -> Place:
    """A hostile folder, next to something that must not change."""
    place = Place(top / "run", top / "outside")
    (place.outside / "folder").mkdir(parents=True)
    (place.outside / "mast-keys-1" / "viewer").mkdir(parents=True)
    (place.outside / "precious").write_text("precious")
    shutil.copytree(sound, place.folder)
    spoil(place)
    return place


def check_harmless(ended: Ended, name: str) -> None:
    """A command has ended with a documented code, and at most one line of error."""
    assert ended.code in KNOWN_CODES, f"{name}: {ended}"
    assert "Traceback" not in ended.err, f"{name}: {ended.err}"
    if ended.code > 2:
        assert [line for line in ended.err.splitlines() if line and not line.startswith("warning:")][1:] == [], ended


@pytest.fixture
def quiet_viewers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Viewers that end at once, and figures that are not painted: what they read is tested here."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a viewer of a running run was started")

    monkeypatch.setattr(PageServer, "wait", lambda self: None)
    monkeypatch.setattr(observers, "start", refuse)
    monkeypatch.setattr(drawing, "png", lambda figure: b"")
    monkeypatch.setattr(drawing, "svg", lambda figure: b"")


@pytest.mark.usefixtures("quiet_viewers")
@pytest.mark.parametrize("name", ALL)
def test_a_hostile_folder_does_no_harm(
    name: str, sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    for number, title in enumerate(commands_of(name, every=request.config.getoption("fuzz"))):
        top = tmp_path / str(number)
        place = spoilt(sound, top, ALL[name])
        paths = {"RUN": place.folder, "SOUND": sound, "OUT": top / "out/new"}
        paths |= {word: top / "out" / word for word in ("OUT.gif", "OUT.png")}
        (top / "out").mkdir()
        monkeypatch.chdir(place.folder)
        before = contents(place.outside)
        with limited_to(MAX_S):
            ended = command(*(paths.get(word, word) for word in COMMANDS[title]))
        check_harmless(ended, title)
        assert contents(place.outside) == before, f"{title}: wrote outside the folder"
        assert {path.name for path in top.iterdir()} <= {"run", "outside", "out", "evil.py"}
        monkeypatch.chdir(tmp_path)
        shutil.rmtree(top)


@pytest.mark.parametrize(
    "name", [name for number, name in enumerate(ALL) if number % 4 == 1 or name in dict(wrong_types())]
)
def test_the_python_interface_refuses_a_hostile_folder_with_an_error_of_the_testbed(
    name: str, sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = spoilt(sound, tmp_path, ALL[name])
    monkeypatch.chdir(place.folder)
    before = contents(place.outside)
    with limited_to(MAX_S):
        try:
            run = mast.open(place.folder)
        except MastError:
            return
        for read in (
            *(partial(getattr, run, part) for part in ("id", "name", "status", "seed", "running", "agents", "summary")),
            *(
                partial(getattr, run, part)
                for part in ("metrics", "objects", "attacks", "targets", "truth", "headline")
            ),
            partial(repr, run),
            lambda: list(run.messages("cc/picture")),
        ):
            try:
                read()
            except MastError:
                continue
    assert contents(place.outside) == before


def test_code_of_a_folder_runs_only_if_it_is_confirmed_and_is_named_first(sound: Path, tmp_path: Path) -> None:
    place = spoilt(sound, tmp_path, CASES["module_inside"])
    file = str(place.folder / "evil.py")
    refused = command("report", place.folder)
    assert refused.code == UntrustedCode.exit_code == 19
    assert file in refused.err
    assert f"mast report {place.folder} --trust" in refused.err
    assert not place.marker.exists()
    confirmed = command("report", place.folder, "--trust")
    assert confirmed.code == 0, confirmed.err
    assert place.marker.exists()
    assert f"running code that {place.folder} names: {file}" in " ".join(confirmed.err.split())


def test_a_file_that_the_command_line_names_needs_no_confirmation(sound: Path, tmp_path: Path) -> None:
    place = spoilt(sound, tmp_path, CASES["module_inside"])
    (place.folder / "evil.py").write_text("from mast_zenoh import scenario\n\ndef scenario():\n    return {}\n")
    shutil.copytree(sound, tmp_path / "again")
    words = ("replay", place.folder, "--runtime", "inproc", "--no-report", "--out", tmp_path / "new")
    assert command(*words).code == UntrustedCode.exit_code
    named = command(*words, "--scenario", place.folder / "evil.py")
    assert named.code != UntrustedCode.exit_code, named.err


def test_a_run_of_another_installation_is_measured_by_the_shipped_evaluator(sound: Path, tmp_path: Path) -> None:
    place = spoilt(sound, tmp_path, CASES["node_files_beside_the_scenario"])
    assert command("report", place.folder).code == 0
    assert not place.marker.exists()


@pytest.mark.parametrize("name", ["wide_metrics", "wide_run", "deep_metrics", "sparse_scenario", "device_as_scene_npz"])
def test_memory_and_time_of_reading_a_hostile_folder_are_bounded(name: str, sound: Path, tmp_path: Path) -> None:
    place = spoilt(sound, tmp_path, ALL[name])
    words = [sys.executable, "-P", "-m", "mast_zenoh", "snapshot", str(place.folder), "--out", str(tmp_path / "x.png")]
    measured = measure(words, 3 * MAX_S)  # the machine may be busy
    assert measured.code in KNOWN_CODES
    assert measured.peak_bytes < MAX_PEAK_BYTES
    assert measured.user_s < MAX_S


def test_no_process_is_signalled_because_a_folder_names_it(
    sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = spoilt(sound, tmp_path, CASES["running_elsewhere"])
    signals: list[object] = []
    monkeypatch.setattr(os, "kill", lambda *call: signals.append(call))
    for words in (("view",), ("logs",), ("deploy", "down")):
        command(*words, place.folder)
    command("release", place.folder, "--name", "adversary_1")
    assert signals == []


#: Bytes, more than a command may use.
_UNPACKED = 3 << 29


def chunk_that_claims_to_be_small(place: Place) -> None:
    """A chunk of zeros whose record says that it holds a hundred bytes."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    block = bytes(1 << 24)
    packed = b"".join(packer.compress(block) for _ in range(_UNPACKED >> 24)) + packer.flush()
    body = struct.pack("<QQQI", 0, 0, 100, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    record = struct.pack("<BQ", Opcode.CHUNK, len(body)) + body
    (place.folder / "messages.mcap").write_bytes(MCAP0_MAGIC + record)


def table_of_one_value(place: Place) -> None:
    """A column of one repeated value."""
    zeros = pyarrow.array(np.zeros(1 << 24, np.int64))
    with parquet.ParquetWriter(
        place.folder / "objects.parquet", pyarrow.schema({"frame": pyarrow.int64()}), compression="zstd"
    ) as writer:
        for _ in range(_UNPACKED >> 27):
            writer.write_table(pyarrow.table({"frame": zeros}))


def text_in_a_dictionary(place: Place) -> None:
    """Rows that all name one long text."""
    text = pyarrow.array(["x" * (1 << 20)])
    column = pyarrow.DictionaryArray.from_arrays(pyarrow.array(np.zeros(1 << 14, np.int32)), text)
    parquet.write_table(pyarrow.table({"agent": column, "frame": np.arange(1 << 14)}), place.folder / "metrics.parquet")


def scene_of_zeros(place: Place) -> None:
    """An archive whose member is compressed."""
    with (
        zipfile.ZipFile(place.folder / "scene.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
        archive.open("head.npy", "w", force_zip64=True) as member,
    ):
        for _ in range(_UNPACKED >> 24):
            member.write(bytes(1 << 24))


#: Each with two commands that read its file.
BOMBS: dict[Case, tuple[str, str]] = {
    chunk_that_claims_to_be_small: ("export pcap", "diff"),
    table_of_one_value: ("export csv", "snapshot"),
    text_in_a_dictionary: ("export csv", "snapshot"),
    scene_of_zeros: ("snapshot", "replay"),
}


@pytest.mark.parametrize("bomb", BOMBS, ids=lambda bomb: bomb.__name__)
def test_a_bomb_costs_bounded_memory_and_time(bomb: Case, sound: Path, tmp_path: Path) -> None:
    place = spoilt(sound, tmp_path, bomb)
    paths = {
        "RUN": str(place.folder),
        "SOUND": str(sound),
        "OUT": str(tmp_path / "x"),
        "OUT.png": str(tmp_path / "x.png"),
    }
    for title in BOMBS[bomb]:
        words = [sys.executable, "-P", "-m", "mast_zenoh", *(paths.get(word, word) for word in COMMANDS[title])]
        measured = measure(words, 60)
        assert measured.code in KNOWN_CODES, title
        assert measured.peak_bytes < MAX_PEAK_BYTES, title
