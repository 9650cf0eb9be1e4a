"""Debian's Chromium under playwright, for tests of pages; a page may ask no other host for anything."""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from chromium import Unavailable
from chromium import browser as started_browser

#: Number of frames of the runs that page tests share, and the one that pages show first: under attack.
FRAMES, FRAME = 56, 40

#: How many pixels of the first panel have a colour, and how many of them are near a place in m.
_COLOURED = """([colour, x, y, tolerance, reach]) => {
  const { canvas } = viewer.panels[0];
  const wanted = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  const { data, width } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const [px, py] = viewer.viewport.toScreen(x, y, canvas.clientWidth, canvas.clientHeight);
  let [all, near] = [0, 0];
  for (let i = 0; i < data.length; i += 4) {
    if (wanted.some((value, channel) => Math.abs(data[i + channel] - value) > tolerance)) continue;
    all++;
    near += Math.hypot((i / 4) % width - px, Math.floor(i / 4 / width) - py) < reach;
  }
  return [all, near];
}"""

_RUNNING: list[Any] = []


@contextmanager
def chromium() -> Iterator[Any]:
    """A browser; skips the test, with the reason, where there is none."""
    if _RUNNING:  # of another fixture: playwright runs once in a thread
        yield _RUNNING[0]
        return
    with ExitStack() as stack:
        try:
            browser = stack.enter_context(started_browser())
        except Unavailable as reason:
            pytest.skip(str(reason))
        _RUNNING.append(browser)
        stack.callback(_RUNNING.clear)
        yield browser


class WatchedPage:
    """A page that remembers every request and every error.

    page: playwright's;  requests: addresses;  errors: of its scripts
    """

    def __init__(
        self, browser: Any, address: str, *, width: int = 1200, height: int = 900, theme: str = "light"
    ) -> None:
        self.page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=theme)
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda line: self.errors.append(line.text) if line.type == "error" else None)
        self.address = address
        self.page.goto(address)
        self.page.wait_for_selector(".viewer.v-ready", timeout=60_000)
        self.settle()

    def run(self, expression: str, argument: Any = None) -> Any:
        """The value of an expression in the page."""
        return self.page.evaluate(expression, argument)

    def settle(self) -> None:
        """Wait until the page has drawn."""
        self.run("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def coloured(self, colour: str, x: float, y: float, tolerance: int = 12, reach: int = 3) -> tuple[int, int]:
        """How many pixels of the first panel have a colour, and how many of them are near a place.

        colour: #rrggbb;  x, y: m;  tolerance: in each channel;  reach: px
        """
        everywhere, near = self.run(_COLOURED, [colour, x, y, tolerance, reach])
        return everywhere, near

    def screenshot(self, name: str) -> None:
        """Keep a screenshot, if $MAST_TEST_SCREENSHOTS names a folder."""
        folder = os.environ.get("MAST_TEST_SCREENSHOTS")
        if folder:
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=str(Path(folder) / f"{name}.png"))

    def close(self) -> None:
        """Close the page; fails if it asked for anything but itself, or if a script failed."""
        self.page.close()
        assert self.requests == [self.address]
        assert self.errors == []
