"""The wirings that a recorded run had, one after the other."""

from __future__ import annotations

from pathlib import Path

from mast_zenoh.errors import RunFolderError
from mast_zenoh.messagelog.events import REWIRED
from mast_zenoh.messagelog.reader import events
from mast_zenoh.run_files import read_json
from mast_zenoh.wiring.model import Wiring


def recorded_wirings(path: Path) -> list[tuple[int, Wiring]]:
    """The wirings of the run in a folder, each with the frame after which it holds; the first one with -1.

    Raises RunFolderError if one cannot be read.
    """
    changes = [(event.frame, event.wiring) for event in events(path) if event.what == REWIRED]
    try:
        if not changes or changes[0][0] >= 0:
            changes.insert(0, (-1, read_json(path / "wiring.json")))
        return [(frame, Wiring.from_json(wiring)) for frame, wiring in changes]
    except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise RunFolderError(f"{path}: the wiring of the run cannot be read: {error!r}") from None
