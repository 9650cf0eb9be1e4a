"""Kernels that encode and decode along a program: ITU-T X.691 (02/2021), unaligned, as one canonical encoding.

`layout` describes programs and flat values. Without compiled kernels, there is no version: ConfigurationError.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import numpy.typing as npt

from mast_zenoh.kernels import kernel, missing

Values = npt.NDArray[np.int64]


class CodecFault(IntEnum):
    """What is wrong with bytes or values; `kernels/uper.pxd` repeats them."""

    TRUNCATED = 1
    TRAILING = 2
    PADDING = 3
    RANGE = 4
    COUNT = 5
    PRESENCE = 6
    LONGER = 7
    FRAGMENTED = 8
    OPEN_LENGTH = 9
    NO_ADDITION = 10
    ADDITIONS = 11
    WIDE_INTEGER = 12
    ROWS = 13


#: Why a kernel refuses bytes or values: the fault, the offending number, and the numbers of fields, elements and
#: alternatives on the way to it.
Refusal = tuple[int, int, tuple[int, ...]]


@kernel
def decode_values(program: Values, data: bytes) -> tuple[Values | None, Refusal | None]:
    """The flat values of a message, or why it is refused."""
    raise missing("reading CPMs and CAMs")


@kernel
def encode_values(program: Values, values: Values) -> tuple[bytes | None, Refusal | None]:
    """The bytes of a message, or why its flat values are refused."""
    raise missing("writing CPMs and CAMs")
