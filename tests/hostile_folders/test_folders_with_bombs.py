"""Small files that unpack to gigabytes, in a run folder: refused within bounded memory.

The bounds of the readers themselves are tested where the readers are.
"""

from __future__ import annotations

import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pyarrow
import pytest
import zstandard
from hostile_folders import COMMANDS, Case, Place
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from measured_process import measure
from pyarrow import parquet
from test_hostile_folders import KNOWN_CODES, MAX_PEAK_BYTES, spoilt

pytestmark = pytest.mark.heavy

#: Bytes, more than a command may use.
_UNPACKED = 2 << 30


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


BOMBS: tuple[Case, ...] = (chunk_that_claims_to_be_small, table_of_one_value, text_in_a_dictionary, scene_of_zeros)


@pytest.mark.parametrize("bomb", BOMBS, ids=lambda bomb: bomb.__name__)
def test_a_bomb_costs_bounded_memory_and_time(bomb: Case, sound: Path, tmp_path: Path) -> None:
    place = spoilt(sound, tmp_path, bomb)
    paths = {
        "RUN": str(place.folder),
        "SOUND": str(sound),
        "OUT": str(tmp_path / "x"),
        "OUT.png": str(tmp_path / "x.png"),
    }
    for command in ("export csv", "snapshot", "diff", "replay"):
        words = [sys.executable, "-P", "-m", "mast_zenoh", *(paths.get(word, word) for word in COMMANDS[command])]
        measured = measure(words, 60)
        assert measured.code in KNOWN_CODES, command
        assert measured.peak_bytes < MAX_PEAK_BYTES, command
