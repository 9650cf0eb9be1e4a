"""Colours of objects and agents, in all figures and files."""

from __future__ import annotations

#: The paper's colour key for boxes (its figures 4 to 6), made bright enough for a dark ground. In drawing order.
OUTCOME_COLOURS = {
    "unevaluated": "#3fd45f",
    "truth matched": "#ffffff",
    "track matched": "#3f8cff",
    "truth missed": "#ffd60a",
    "track false": "#ff3b3b",
}
#: Adversaries, their wires and their effects, in every figure.
ADVERSARY = "#ff4fd8"
#: The ground of other viewers, on which white boxes are visible.
GROUND = "#10141b"
BUILDING_EDGE, AGENT = "#465062", "#7fe3ff"


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
