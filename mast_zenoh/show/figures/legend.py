"""The legend of pictures of frames: an entry for each thing that they show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mast_zenoh.metrics.estimates import OWN, TRUTH
from mast_zenoh.runs.events import states_at, withheld_at
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.interposers import attacked_at, interposers
from mast_zenoh.runs.spoofers import spoofers
from mast_zenoh.show.figures.birdseye import DASHED, face
from mast_zenoh.show.figures.style import Theme
from mast_zenoh.show.palette import OUTCOME_LABELS

#: Points, size of marks.
_MARK = 7


def legend_entries(frames: Sequence[Frame], theme: Theme, *, camera: bool = False) -> list[Artist]:
    """The entries for all that pictures of these frames show. camera: in its view, without agents and arrows"""
    if all(estimate == TRUTH for frame in frames for estimate in frame.boxes):
        entries: list[Artist] = [Patch(facecolor="none", edgecolor=theme.outcomes["truth matched"], label="object")]
    else:
        boxes = (by_outcome for frame in frames for by_outcome in frame.boxes.values())
        evaluated = not any(len(by_outcome["unevaluated"]) for by_outcome in boxes)
        entries = [
            Patch(facecolor=face(name, colour), edgecolor=colour, linewidth=1.5, label=OUTCOME_LABELS[name])
            for name, colour in ((name, theme.outcomes[name]) for name in OUTCOME_LABELS)
            if not (evaluated and name == "unevaluated")
        ]
    if not camera:
        entries += _agents(frames, theme)
    if any(len(withheld_at(frame.run, frame.index)) for frame in frames if not frame.boxes.keys() <= {*OWN}):
        entries.append(Patch(facecolor="none", edgecolor=theme.withheld, linestyle=DASHED, label="withheld"))
    changes = [frame.marks(estimate) for frame in frames for estimate in frame.boxes]
    kinds = (("added", "D", "inserted"), ("removed", "x", "removed"), ("moved", "$\\rightarrow$", "moved"))
    return entries + [
        mark_entry(marker, theme.adversary, f"{done} by adversary", hollow=marker == "D")
        for kind, marker, done in kinds[: 2 if camera else 3]
        if any(len(getattr(each, kind)) for each in changes)
    ]


def _agents(frames: Sequence[Frame], theme: Theme) -> list[Artist]:
    """The entries for agents, their states, and adversaries on their wires."""
    runs = {frame.run.path: frame.run for frame in frames}
    kinds = {agent.kind for run in runs.values() if run.files.scene is not None for agent in run.files.scene.agents}
    states = {state for frame in frames for state in states_at(frame.run, frame.index).values()} if kinds else set()
    colour = theme.withheld if states else theme.agent
    entries: list[Artist] = [mark_entry("o", colour, "vehicle with sensors", hollow=True)] if kinds - {"static"} else []
    entries += [mark_entry("^", colour, "roadside sensor")] if "static" in kinds else []
    entries += [mark_entry("^", theme.states[state], f"{state} agent") for state in theme.states if state in states]
    known = {path: interposers(run) for path, run in runs.items()}
    if kinds and any(attacked_at(known[frame.run.path], frame.index) for frame in frames):
        # Marks have the colours of states; names, that of adversaries.
        marker, size = ("$name$", 3.0 * _MARK) if states else ("^", _MARK)
        entries.append(mark_entry(marker, theme.adversary, "adversary on its wire", size=size))
    if any(spoofers(frame.run, np.array([frame.index])) for frame in frames):
        entries.append(mark_entry("s", theme.adversary, "spoofer of a lidar"))
    return entries


def mark_entry(marker: str, colour: str, label: str, *, hollow: bool = False, size: float = _MARK) -> Line2D:
    """The entry for a mark; hollow: its outline alone."""
    inside, width = "none" if hollow else colour, 0.0 if len(marker) > 1 else 1.5
    return Line2D([], [], linestyle="", marker=marker, ms=size, mfc=inside, mec=colour, mew=width, label=label)


def draw_legend(figure: Figure, entries: Sequence[Artist], theme: Theme, size: float) -> float:
    """Put a legend at the bottom of a figure, in as few lines as fit; returns its height in inches.

    size: points, of text
    """
    look: dict[str, Any] = {"loc": "lower center", "frameon": False, "labelcolor": theme.ink, "fontsize": size}
    look |= {"handlelength": 1.3, "columnspacing": 1.3, "labelspacing": 0.4, "borderaxespad": 0.3}
    for lines in range(1, len(entries) + 1):
        legend = figure.legend(handles=list(entries), ncols=-(-len(entries) // lines), **look)
        extent = legend.get_window_extent()
        if extent.width <= 0.97 * figure.bbox.width or lines == len(entries):
            break
        legend.remove()
    return float(extent.height / figure.dpi)
