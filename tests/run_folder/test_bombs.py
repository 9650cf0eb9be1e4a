"""Compressed files that claim little and unpack to much are refused before they take memory; real files are read."""

import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from pyarrow import feather as arrow_feather
from pyarrow import parquet as arrow_parquet

from mast_zenoh.errors import RunFolderError
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.run_folder import unpacking
from mast_zenoh.run_folder.recording import reader
from mast_zenoh.run_folder.recording.writer import MessageLog
from mast_zenoh.run_folder.tables import TableFile, from_arrow, read_table
from mast_zenoh.wiring.model import Input

pytestmark = pytest.mark.heavy

#: In a process with 900 MB of address space beyond what it has after its imports, print the error's first line.
_LIMITED = """
import resource, sys
from pathlib import Path
from mast_zenoh.run_folder.tables import TableFile, read_table
from mast_zenoh.run_folder.recording.reader import read as read_recording
from mast_datasets.argoverse import read_poses
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 900_000_000,) * 2)
path = Path(sys.argv[1])
try:
    if path.suffix == ".mcap":
        list(read_recording(path))
    elif path.suffix == ".feather":
        read_poses(path, None)
    elif sys.argv[2:] == ["rows"]:
        TableFile(path).rows(TableFile(path).columns)
    else:
        read_table(path)
except Exception as error:
    print(type(error).__name__, error)
"""


def chunk_file(path: Path, data: bytes, claimed: int, compression: str = "zstd") -> Path:
    """An MCAP file of one chunk."""
    name = compression.encode()
    content = (0).to_bytes(8, "little") * 2 + claimed.to_bytes(8, "little") + (0).to_bytes(4, "little")
    content += len(name).to_bytes(4, "little") + name + len(data).to_bytes(8, "little") + data
    path.write_bytes(MCAP0_MAGIC + bytes([Opcode.CHUNK]) + len(content).to_bytes(8, "little") + content)
    return path


def recording(path: Path) -> Path:
    """A recording of clocks, all in one chunk."""
    log = MessageLog(path)
    log.begin({"clock": Input("everything", "", "clock", "simulator")})
    for frame in range(5):
        header = Header("clock", "simulator", frame, frame * 10**8, frame)
        log.add("clock", codec.encode(codec.conform(header, {})), header, frame)
    log.close()
    return path


def zstd_zeros(size: int) -> bytes:
    """Zeros, compressed; the frame says how many."""
    compressor = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    piece = bytes(10_000_000)
    return b"".join(compressor.compress(piece[: min(len(piece), size - at)]) for at in range(0, size, len(piece))) + (
        compressor.flush()
    )


def table_bombs(folder: Path) -> list[Path]:
    """Files below 2.5 MB that unpack to more than 2.4 GB; text to a terabyte."""
    many = pyarrow.DictionaryArray.from_arrays(np.zeros(1_000_000, np.int32), ["x" * 1_000_000])
    zeros = pyarrow.table({name: np.zeros(10_000_000) for name in map(str, range(30))})
    arrow_parquet.write_table(pyarrow.table({"a": many}), folder / "text.parquet", store_schema=False)
    arrow_parquet.write_table(pyarrow.table({"a": many}), folder / "dictionary.parquet")
    arrow_parquet.write_table(zeros, folder / "repeated.parquet", compression="zstd")
    arrow_parquet.write_table(zeros, folder / "plain.parquet", compression="zstd", use_dictionary=False)
    arrow_feather.write_feather(zeros, folder / "zstd.feather", compression="zstd", chunksize=10_000_000)
    return sorted(folder.iterdir())


def test_bombs_are_refused_in_one_line_within_900_mb(tmp_path: Path) -> None:
    bombs = table_bombs(tmp_path)
    frame = zstd_zeros(2_000_000_000)
    bombs.append(chunk_file(tmp_path / "lies.mcap", frame, 1000))
    bombs.append(chunk_file(tmp_path / "honest.mcap", frame, 2_000_000_000))
    words = [[str(path)] for path in bombs] + [[str(path), "rows"] for path in bombs if path.suffix == ".parquet"]
    for path, *how in words:
        assert Path(path).stat().st_size < 2_500_000
        done = subprocess.run(
            [sys.executable, "-c", _LIMITED, path, *how], capture_output=True, text=True, check=False, timeout=60
        )
        (line,) = done.stdout.splitlines()
        assert line.startswith(("RunFolderError ", "SceneError ")), (path, line, done.stderr)
        assert Path(path).name in line
        assert "found" in line


def test_compressions_that_recordings_never_use_are_refused(tmp_path: Path) -> None:
    path = chunk_file(tmp_path / "x.mcap", b"x", 1, "lz4")
    with pytest.raises(RunFolderError, match=r"x\.mcap: byte \d+: .*compression 'lz4', expected 'zstd'"):
        list(reader.read(path))


def test_a_chunk_of_too_many_messages_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "MAX_CHUNK_MESSAGES", 2)
    message = bytes([Opcode.MESSAGE]) + (22).to_bytes(8, "little") + bytes(22)
    data = message * 3
    with pytest.raises(RunFolderError, match="found more than 2 messages"):
        list(reader.read(chunk_file(tmp_path / "x.mcap", data, len(data), "")))


def test_messages_that_wait_for_later_chunks_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = recording(tmp_path / "run.mcap")
    assert list(reader.read(path))
    monkeypatch.setattr(reader, "MAX_WAITING_BYTES", 2000)
    with pytest.raises(RunFolderError, match="wait for earlier ones in later chunks, expected at most 2000"):
        list(reader.read(path))


@pytest.mark.parametrize("compression", ["snappy", "zstd", "gzip", "lz4", "brotli", "none"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_tables_of_any_compression_are_read_as_written(tmp_path: Path, compression: str, version: str) -> None:
    n = 5000
    table = pyarrow.table(
        {
            "number": np.arange(float(n)),
            "text": [f"x{i % 50}" for i in range(n)],
            "some": pyarrow.array([None, 1] * (n // 2)),
            "dictionary": pyarrow.array(["q", None] * (n // 2)).dictionary_encode(),
            "yes": [True] * n,
            "nothing": pyarrow.nulls(n),
        }
    )
    path = tmp_path / "t.parquet"
    arrow_parquet.write_table(table, path, compression=compression, data_page_version=version, row_group_size=1500)
    assert unpacking.read_parquet(path).equals(table)
    assert TableFile(path).rows(["text"])["text"].tolist() == table["text"].to_pylist()
    assert unpacking.read_parquet(path, ["text", "number"]).column("text").equals(table.column("text"))
    arrow_parquet.write_table(table.slice(0, 0), path, compression=compression)
    assert unpacking.read_parquet(path).schema == table.schema


@pytest.mark.parametrize("compression", ["zstd", "lz4", "uncompressed"])
def test_feather_files_are_read_as_they_were_written(tmp_path: Path, compression: str) -> None:
    table = pyarrow.table({"number": np.arange(5000.0), "text": [f"x{i % 50}" for i in range(5000)]})
    arrow_feather.write_feather(table, tmp_path / "t.feather", compression=compression, chunksize=1500)
    assert unpacking.read_feather(tmp_path / "t.feather").equals(table)


def test_damaged_tables_raise_errors_that_readers_expect(tmp_path: Path) -> None:
    table = pyarrow.table({"number": np.arange(100.0), "text": [f"x{i % 50}" for i in range(100)]})
    arrow_parquet.write_table(table, tmp_path / "t.parquet")
    arrow_feather.write_feather(table, tmp_path / "t.feather")
    for name, read in (("t.parquet", unpacking.read_parquet), ("t.feather", unpacking.read_feather)):
        whole = (tmp_path / name).read_bytes()
        for at in range(0, len(whole), 7):
            data = bytearray(whole)
            data[at] ^= 0xFF
            (tmp_path / name).write_bytes(data)
            with suppress(OSError, pyarrow.ArrowException):
                read(tmp_path / name)


def test_text_that_would_expand_is_refused_and_names_the_file(tmp_path: Path) -> None:
    long = pyarrow.DictionaryArray.from_arrays(np.zeros(100_000, np.int32), ["x" * 10_000])
    arrow_parquet.write_table(pyarrow.table({"a": long}), tmp_path / "t.parquet")
    with pytest.raises(RunFolderError, match=r"t\.parquet: 100000 rows of up to 10000 characters: found 4000000000"):
        read_table(tmp_path / "t.parquet")
    with pytest.raises(pyarrow.ArrowInvalid):
        from_arrow(pyarrow.table({"a": long}))


def test_a_table_of_many_different_texts_is_refused(tmp_path: Path) -> None:
    """Each takes more memory than its characters."""
    texts = pyarrow.table({"agent": pyarrow.array(map(str, range(200_000)))})
    for number, dictionary in enumerate((True, False)):
        path = tmp_path / f"{number}.parquet"
        arrow_parquet.write_table(texts, path, use_dictionary=dictionary)
        with pytest.raises(pyarrow.ArrowInvalid, match="bytes unpacked or more, expected at most"):
            unpacking.read_parquet(path, max_bytes=10_000_000)


def test_text_counts_by_its_bytes(tmp_path: Path) -> None:
    path = tmp_path / "table.parquet"
    arrow_parquet.write_table(pyarrow.table({"agent": ["\N{PILE OF POO}" * 1000] * 1000}), path)
    with pytest.raises(pyarrow.ArrowInvalid, match="expected at most"):
        unpacking.read_parquet(path, max_bytes=3_900_000)
    assert unpacking.read_parquet(path, max_bytes=4_100_000).num_rows == 1000
