"""Unpacks a chunk of messages.mcap, within limits."""

from __future__ import annotations

import zlib
from io import BytesIO
from typing import IO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message
from mcap.records import Schema as SchemaRecord

#: Limits on a chunk, unpacked. The writer begins a new one after 1 MiB or CHUNK_MESSAGES, and a message has 16 MiB at
#: most.
MAX_CHUNK_BYTES = 64 << 20
MAX_CHUNK_MESSAGES = 200_000


def records(file: IO[bytes], length: int) -> list[McapRecord]:
    """The channels, schemas and messages in the chunk that begins here.

    length: of the chunk in the file, bytes
    Raises ValueError if they exceed a limit; ZstdError, McapError, struct.error or OverflowError if it is damaged.
    """
    if length > MAX_CHUNK_BYTES:
        raise ValueError(f"found {length} bytes, expected at most {MAX_CHUNK_BYTES}")
    chunk = Chunk.read(ReadDataStream(BytesIO(file.read(length))))
    content = _unpacked(chunk)
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("its checksum is not that of its content")
    stream, records, messages = ReadDataStream(BytesIO(content)), list[McapRecord](), 0
    while stream.count < len(content):
        opcode, length = stream.read1(), stream.read8()
        if opcode == Opcode.MESSAGE:
            messages += 1
            if messages > MAX_CHUNK_MESSAGES:
                raise ValueError(f"found more than {MAX_CHUNK_MESSAGES} messages, expected at most as many")
            records.append(Message.read(stream, length))
        elif opcode == Opcode.CHANNEL:
            records.append(Channel.read(stream))
        elif opcode == Opcode.SCHEMA:
            records.append(SchemaRecord.read(stream))
        else:
            stream.read(length)
    return records


def _unpacked(chunk: Chunk) -> bytes:
    """The content of a chunk. Raises ValueError before more memory is used than MAX_CHUNK_BYTES."""
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:  # zeros compress to almost nothing
        raise ValueError(f"found {chunk.uncompressed_size} bytes in one chunk, expected at most {MAX_CHUNK_BYTES}")
    if chunk.compression not in ("zstd", ""):
        raise ValueError(f"found compression {chunk.compression!r:.20}, expected 'zstd', as recordings are written")
    size = len(chunk.data)
    if chunk.compression:
        size = zstandard.frame_content_size(chunk.data)  # the decompressor allocates this much; -1: it is not given
    if size not in (-1, chunk.uncompressed_size):
        raise ValueError(f"found {size} bytes in one chunk, which claims to have {chunk.uncompressed_size}")
    if not chunk.compression:
        return chunk.data
    return zstandard.decompress(chunk.data, chunk.uncompressed_size)
