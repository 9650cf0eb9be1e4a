"""The first frame of which a recording lacks messages, measured from the recording itself."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from mast_zenoh.errors import RunFolderError
from mast_zenoh.messagelog.reader import file_of, read


def first_gap(path: Path) -> int:
    """The first frame that may be incomplete in a recording: the one before the first without truth.

    0 for a recording that cannot be read.
    """
    try:
        frames = {message.frame for message in read(file_of(path)) if message.message == "truth"}
    except RunFolderError:
        return 0
    return max(0, next(frame for frame in range(len(frames) + 1) if frame not in frames) - 1)


def first_missing(path: Path, publisher: str) -> int | None:
    """The first frame without a message of `publisher`; None if its sequence numbers have no gap.

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
        frames.get(seq - 1, -1) + 1
        for frames in recorded.values()
        if (seq := next(number for number in range(len(frames) + 1) if number not in frames)) < len(frames)
    ]
    return min(missing, default=None)
