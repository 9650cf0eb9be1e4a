"""Runs commands of `mast` in this process, as the command line does, and says what they did."""

import contextlib
import io
import sys
import traceback
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from mast_zenoh.cli import app


class Ended(NamedTuple):
    """How a command ended: its exit code, -1 for a traceback, and what it printed."""

    code: int
    out: str
    err: str


def command(*words: str | Path) -> Ended:
    """Run `mast` with these words."""
    out, err = io.StringIO(), io.StringIO()
    with (
        patch.object(sys, "argv", ["mast", *map(str, words)]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            code = app.carry_out()
        except Exception:
            traceback.print_exc()
            code = -1
    return Ended(code, out.getvalue(), err.getvalue())
