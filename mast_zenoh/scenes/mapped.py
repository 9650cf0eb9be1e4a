"""Arrays that stay in an uncompressed .npz file: what is asked for is copied from there, and checked."""

from __future__ import annotations

import math
import mmap
import struct
import zipfile
from collections.abc import Callable
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

#: Of the local header of a member: the lengths of its name and of its extra field, which follow it.
_LENGTHS = struct.Struct("<26xHH")
_READ_HEADER: dict[tuple[int, int], Callable[[IO[bytes]], Any]] = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
}


def check_stored(archive: zipfile.ZipFile, size: int) -> None:
    """Raise ValueError if the members of a file of `size` bytes unpack to more, as compressed ones can."""
    unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > size:
        raise ValueError(f"unpacks to {unpacked} bytes, more than its own {size}")


def mapped_arrays(file: BinaryIO) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file by name, in its memory, as they are there: read-only, and perhaps not aligned.

    One that is compressed, or in another version of the format, is read.

    Raises ValueError if a member is not within the file, overlaps another, or has another size than its header says;
    and what zipfile and NumPy raise for a damaged file.
    """
    content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    arrays: dict[str, NDArray[Any]] = {}
    end = 0
    with zipfile.ZipFile(file) as archive:
        check_stored(archive, len(content))
        for info in sorted(archive.infolist(), key=lambda info: info.header_offset):
            with archive.open(info) as member:  # it compares the local header
                begin = info.header_offset + _LENGTHS.size + sum(_LENGTHS.unpack_from(content, info.header_offset))
                if not end <= info.header_offset <= begin + info.compress_size <= len(content):
                    raise ValueError(f"{info.filename} overlaps another array, or is not within the file")
                end = begin + info.compress_size
                arrays[info.filename.removesuffix(".npy")] = _array(member, info, content, begin)
    return arrays


def _array(member: IO[bytes], info: zipfile.ZipInfo, content: mmap.mmap, begin: int) -> NDArray[Any]:
    """The array of a member whose bytes begin at `begin`."""
    read_header = _READ_HEADER.get(npy.read_magic(member))
    if read_header and info.compress_type == zipfile.ZIP_STORED:
        shape, is_fortran, dtype = read_header(member)
        header = member.tell()
        if not dtype.hasobject:
            if (size := header + math.prod(shape) * dtype.itemsize) != info.compress_size:
                raise ValueError(f"{info.filename} has {info.compress_size} bytes, expected {size}")
            return np.ndarray(shape, dtype, content, begin + header, order="F" if is_fortran else "C")
    member.seek(0)
    array: NDArray[Any] = npy.read_array(member, allow_pickle=False)
    return array


class MappedArray:
    """An array that stays in its file; an index copies what it asks for, and NumPy's functions copy all.

    check: raises an error if a part has an invalid number; is given the part, and a function from a place in it to that
           in the array
    """

    def __init__(
        self, array: NDArray[Any], check: Callable[[NDArray[Any], Callable[[NDArray[Any]], list[int]]], None]
    ) -> None:
        self._array, self._check = array, check
        self.shape, self.ndim, self.dtype = array.shape, array.ndim, array.dtype

    def __len__(self) -> int:
        return len(self._array)

    def __getitem__(self, key: Any) -> Any:
        part = np.array(self._array[key])

        def place(inside: NDArray[Any]) -> list[int]:
            axes = map(np.arange, self.shape)
            return [int(np.broadcast_to(axis, self.shape)[key][tuple(inside)]) for axis in np.ix_(*axes)]

        self._check(part, place)
        part.setflags(write=False)
        return part[()]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[...], dtype)

    def take(self, rows: NDArray[Any], axis: int = 0) -> NDArray[Any]:
        """Some rows."""
        part: NDArray[Any] = self[rows]
        return part
