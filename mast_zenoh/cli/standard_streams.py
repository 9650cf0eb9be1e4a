"""Standard output and error of the command line: a reader that goes away, or a full disk, costs the text and no run."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any, TextIO


class _Lossy(io.FileIO):
    """A file descriptor that takes everything; from the first failure on, what is written is lost.

    failure: why; None as long as nothing is lost
    """

    failure: OSError | None = None

    def write(self, data: Any, /) -> int:
        """See FileIO."""
        if self.failure is None:
            try:
                return super().write(data)
            except OSError as error:
                self.failure = error
        return memoryview(data).nbytes


def replace() -> None:
    """Replace sys.stdout and sys.stderr by streams whose writers never fail.

    What the terminal's encoding cannot show is escaped. A standard stream that is closed becomes /dev/null, so that no
    file of a run gets its number.
    """
    for _ in range(3):
        descriptor = os.open(os.devnull, os.O_RDWR)
        if descriptor > 2:
            os.close(descriptor)
            break
    sys.stdout = _stream(1, sys.stdout)
    sys.stderr = _stream(2, sys.stderr)


def failed_output() -> OSError | None:
    """Flush both streams; why standard output is incomplete, unless its reader did not want more."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    failure = raw.failure if isinstance(raw, _Lossy) else None
    return None if failure is None or failure.errno == errno.EPIPE else failure


def _stream(descriptor: int, before: TextIO | None) -> TextIO:
    raw = _Lossy(descriptor, "w", closefd=False)
    encoding = before.encoding if before is not None else None
    lines = descriptor == 2 or raw.isatty()
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding=encoding, errors="backslashreplace", line_buffering=lines)
