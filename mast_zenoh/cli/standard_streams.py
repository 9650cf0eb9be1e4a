"""Standard output and error that never fail.

A closed pipe or a full disk loses text, but does not end a run.
"""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any, TextIO


class _Lossy(io.FileIO):
    """A file descriptor that accepts all writes.

    After the first failure, output is discarded.
    failure: the first error; None if nothing was lost
    """

    failure: OSError | None = None

    def write(self, data: Any, /) -> int:
        if self.failure is None:
            try:
                return super().write(data)
            except OSError as error:
                self.failure = error
        return memoryview(data).nbytes


def replace() -> None:
    """Replace sys.stdout and sys.stderr by streams that never fail to write.

    Characters that the terminal's encoding lacks are escaped. A closed standard stream becomes /dev/null, so that no
    file of a run gets its descriptor.
    """
    for _ in range(3):
        descriptor = os.open(os.devnull, os.O_RDWR)
        if descriptor > 2:
            os.close(descriptor)
            break
    sys.stdout = _stream(1, sys.stdout)
    sys.stderr = _stream(2, sys.stderr)


def failed_output() -> OSError | None:
    """Flush both streams; returns why standard output is incomplete.

    None if it is complete, or if its reader closed the pipe.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    failure = raw.failure if isinstance(raw, _Lossy) else None
    return None if failure is None or failure.errno == errno.EPIPE else failure


def is_read() -> bool:
    """Whether standard output still accepts text: nobody has closed the pipe."""
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    return not isinstance(raw, _Lossy) or raw.failure is None


def _stream(descriptor: int, former: TextIO | None) -> TextIO:
    raw = _Lossy(descriptor, "w", closefd=False)
    encoding = former.encoding if former is not None else None
    line_buffered = descriptor == 2 or raw.isatty()
    return io.TextIOWrapper(
        io.BufferedWriter(raw), encoding=encoding, errors="backslashreplace", line_buffering=line_buffered
    )
