"""Debian's Chromium, without a graphics card and without a display."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PROGRAM = Path("/usr/bin/chromium")
FLAGS = (
    *("--no-sandbox", "--disable-background-networking", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
)


class Unavailable(Exception):
    """This machine lacks playwright or Chromium; the message says what to install."""


@contextmanager
def browser() -> Iterator[Any]:
    """Chromium under playwright; raises Unavailable without one of them."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise Unavailable("playwright is not installed: make dev") from None
    if not PROGRAM.is_file():
        raise Unavailable(f"no browser: expected {PROGRAM} (apt-get install chromium)")
    with sync_playwright() as engine:
        running = engine.chromium.launch(executable_path=str(PROGRAM), args=list(FLAGS))
        try:
            yield running
        finally:
            running.close()
