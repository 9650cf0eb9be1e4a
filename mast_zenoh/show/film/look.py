"""What a film or still shows and how it looks: options as users write them, checked."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.metrics.estimates import ESTIMATES, TRUTH
from mast_zenoh.show.figures.style import THEMES, Theme

#: What panels can show.
SHOWN = (*ESTIMATES, TRUTH)
#: px, default widths and heights by number of panels, one or two, without camera views.
_SIZES = {1: (800, 760), 2: (1280, 760)}
_PER_INCH = {"in": 1.0, "cm": 2.54, "mm": 25.4}
_LEAST_PX, _MOST_PX = 240, 8192


class WindowChoice(NamedTuple):
    """Which part of the scene a panel shows.

    follow: keep the agent in the middle;  centre: m, of a fixed window, None: what matters
    half: m, half of the shorter side, None: what matters
    """

    follow: bool = False
    centre: tuple[float, float] | None = None
    half: float | None = None


@dataclass(frozen=True)
class Look:
    """Options of `mast animate` and `mast snapshot` (docs/animations.md).

    agent:     whose estimates are shown; None: the main agent
    estimates: one or two of SHOWN, side by side; None: what the agent's driver believes, without one the picture
    camera:    with the agent's camera view below each bird's-eye view
    window:    `fit`, `follow`, `follow:HALF` or `X,Y,HALF`, m
    theme:     dark or light
    size:      `WIDTHxHEIGHT` with px (the default), in, cm or mm; None: depends on the number of panels
    dpi:       pixels per inch; text has a fixed size in points, so more dpi means larger text in a film of one size
    plain:     panels and legend alone: no title, numbers, strips or caption
    title:     in place of the run's name and the agent
    captions:  `FRAME:TEXT`, in place of the run's own caption of this frame; shown until the next caption, of the run
               or of the user
    """

    agent: str | None = None
    estimates: Sequence[str] | None = None
    camera: bool = False
    window: str = "fit"
    theme: str = "dark"
    size: str | None = None
    dpi: int = 100
    plain: bool = False
    title: str | None = None
    captions: Sequence[str] = ()

    def check(self, panels: int) -> None:
        """Raise ConfigurationError for an invalid option; panels: their number."""
        for estimate in self.estimates or ():
            if estimate not in SHOWN:
                raise ConfigurationError(f"unknown estimate {estimate!r}: expected one of {', '.join(SHOWN)}"
                                         f"{_similar(estimate, SHOWN)}")  # fmt: skip
        if panels not in _SIZES:
            raise ConfigurationError(f"found {panels} panels, expected one or two: mast view shows three")
        if self.theme not in THEMES:
            raise ConfigurationError(f"unknown theme {self.theme!r}: expected one of {', '.join(THEMES)}")
        if not 20 <= self.dpi <= 1200:
            raise ConfigurationError(f"dpi: found {self.dpi}, expected 20 to 1200 pixels per inch")
        self.window_choice()
        self.pixels(panels)
        self.own_captions()

    @property
    def colours(self) -> Theme:
        """The theme."""
        return THEMES[self.theme]

    def pixels(self, panels: int) -> tuple[int, int]:
        """Width and height in px, both even, as video encoders need them; raises ConfigurationError."""
        if self.size is None:
            width, height = _SIZES[panels]
            return width, height + (int(width / panels * 0.25) // 2 * 2 if self.camera else 0)
        match = re.fullmatch(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)(px|in|cm|mm)?", self.size.strip())
        if match is None:
            raise ConfigurationError(f"size: found {self.size!r}, expected WIDTHxHEIGHT, such as 1280x720 or 18x10cm")
        pixels = self.dpi / _PER_INCH[match[3]] if match[3] in _PER_INCH else 1.0
        width, height = (2 * round(float(length) * pixels / 2) for length in match.group(1, 2))
        if min(width, height) < _LEAST_PX or max(width, height) > _MOST_PX:
            raise ConfigurationError(
                f"size: found {self.size!r}, which is {width} by {height} px at {self.dpi} dpi: "
                f"expected {_LEAST_PX} to {_MOST_PX} px"
            )
        return width, height

    def window_choice(self) -> WindowChoice:
        """The window; raises ConfigurationError."""
        kind, _, half = self.window.partition(":")
        follow = kind == "follow"
        if self.window in ("fit", "follow"):
            return WindowChoice(follow)
        with suppress(ValueError):
            x, y, reach = (0.0, 0.0, float(half)) if follow else map(float, self.window.split(","))
            if math.isfinite(x + y + reach) and reach > 0:
                return WindowChoice(follow, None if follow else (x, y), reach)
        raise ConfigurationError(
            f"window: found {self.window!r}, expected fit, follow, follow:HALF or X,Y,HALF with HALF above 0, in m"
        )

    def own_captions(self) -> dict[int, str]:
        """The user's captions by frame; raises ConfigurationError."""
        result = {}
        for caption in self.captions:
            frame, separator, text = caption.partition(":")
            if not separator or not frame.strip().isdecimal():
                raise ConfigurationError(f"caption: found {caption!r}, expected FRAME:TEXT, such as 60:here it begins")
            result[int(frame)] = text.strip()
        return result


def _similar(name: str, known: Sequence[str]) -> str:
    hint = nearest(name, known)
    return hint if "did you mean" in hint else ""
