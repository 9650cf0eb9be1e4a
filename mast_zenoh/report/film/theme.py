"""Colours of films and stills, on dark and on light ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mast_zenoh.report.figures.camera import DARK_CAMERA, CameraColours
from mast_zenoh.report.figures.style import (
    ADVERSARY_ON_LIGHT,
    BUILDING,
    FAINT,
    FAULT_ON_LIGHT,
    GRID,
    GROUND,
    STATES,
    WITHHELD,
)
from mast_zenoh.viewer.palette import ADVERSARY, AGENT, BUILDING_EDGE, OUTCOME_COLOURS


@dataclass(frozen=True)
class Theme:
    """Colours, `#rrggbb`.

    outcomes: of boxes, by the keys of OUTCOME_COLOURS;  states: of judged agents
    ink: text;  faint: secondary text and the outlines of sensors;  camera: of camera views
    """

    ground: str
    building: str
    building_edge: str
    grid: str
    faint: str
    ink: str
    outcomes: Mapping[str, str]
    adversary: str
    fault: str
    agent: str
    states: Mapping[str, str]
    withheld: str
    camera: CameraColours


DARK = Theme(
    GROUND,
    BUILDING,
    BUILDING_EDGE,
    GRID,
    FAINT,
    "#f2f5f9",
    OUTCOME_COLOURS,
    ADVERSARY,
    "#d9a441",
    AGENT,
    STATES,
    WITHHELD,
    DARK_CAMERA,
)
#: The paper's key with black for matched truth; the other colours are darker, so that they are readable on white.
_ON_LIGHT = {
    "unevaluated": "#128a37",
    "truth matched": "#1b1f24",
    "track matched": "#1766e0",
    "truth missed": "#bd8b00",
    "track false": "#d31818",
}
LIGHT = Theme(
    "#ffffff",
    "#dfe3ea",
    "#b4bcc9",
    "#e9edf2",
    "#566070",
    "#1b1f24",
    _ON_LIGHT,
    ADVERSARY_ON_LIGHT,
    FAULT_ON_LIGHT,
    "#00728f",
    {"unknown": "#6b7280", "trusted": "#00728f", "faulty": "#a86400", "suspended": "#c8401c"},
    "#566070",
    CameraColours(
        ground="#ffffff",
        frame="#7a7a7a",
        sky="#e6e6e6",
        road="#f0f0f0",
        grid="#dfdfdf",
        building="#dcdcdc",
        horizon="#c5c5c5",
        outcomes=_ON_LIGHT,
        adversary=ADVERSARY_ON_LIGHT,
    ),
)
#: By name.
THEMES = {"dark": DARK, "light": LIGHT}
