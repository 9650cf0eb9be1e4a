"""Ids of objects: our whole numbers, and the texts and UUIDs of ROS 2."""

from __future__ import annotations

import hashlib
import re

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Ints

UUID_BYTES = 16
_OWN = bytes(8)  # how our UUIDs begin: random ones do not
_DECIMAL = re.compile(r"0|-?[1-9][0-9]{0,18}")
_INT64 = np.iinfo(np.int64)


def uuids(ids: Ints) -> NDArray[np.uint8]:
    """(n, 16) bytes: eight of 0, then the id (n,), highest byte first."""
    result = np.zeros((len(ids), UUID_BYTES), np.uint8)
    result[:, 8:] = ids.astype(">i8").view(np.uint8).reshape(-1, 8)
    return result


def id_of_uuid(uuid: bytes) -> int:
    """The id in one of our UUIDs; a number from the hash of another, equal for equal UUIDs."""
    if uuid.startswith(_OWN):
        return int.from_bytes(uuid[8:], "big", signed=True)
    return _hashed(uuid)


def id_of_text(text: str) -> int:
    """The whole number that a text is, such as `-7`; a number from the hash of another, equal for equal texts."""
    if _DECIMAL.fullmatch(text) and _INT64.min <= int(text) <= _INT64.max:
        return int(text)
    return _hashed(text.encode(errors="surrogatepass"))


def _hashed(data: bytes) -> int:
    """A number of 63 bits."""
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "big") >> 1
