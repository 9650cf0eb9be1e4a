"""Finds the first frame for which a recording lacks messages."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container
from itertools import count
from pathlib import Path

from mast_zenoh.errors import RunFolderError
from mast_zenoh.messagelog.reader import file_of, read


def first_incomplete_frame(path: Path) -> int:
    """The first frame that may be incomplete: the one before the first without truth.

    0 for a recording that cannot be read.
    """
    try:
        frames = {message.frame for message in read(file_of(path)) if message.message == "truth"}
    except RunFolderError:
        return 0
    return max(0, _first_absent(frames) - 1)


def first_missing_frame(path: Path, publisher: str) -> int | None:
    """The first frame without a message of `publisher`; None if none is missing.

    A missing message is a gap in the sequence numbers of its wire.
    A message counts as recorded if it was recorded on any leg of its wire. Missing messages after the last recorded one
    are not detected. 0 for a recording that cannot be read.
    """
    recorded: defaultdict[str, dict[int, int]] = defaultdict(dict)  # by wire: sequence number to frame
    try:
        for message in read(file_of(path)):
            if message.publisher == publisher and not message.malformed:
                recorded[message.wire][message.seq] = message.frame
    except RunFolderError:
        return 0
    missing = [
        frames.get(seq - 1, -1) + 1 for frames in recorded.values() if (seq := _first_absent(frames)) < len(frames)
    ]
    return min(missing, default=None)


def _first_absent(numbers: Container[int]) -> int:
    """The smallest number from 0 that is absent."""
    return next(number for number in count() if number not in numbers)
