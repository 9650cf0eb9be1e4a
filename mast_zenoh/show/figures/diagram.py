"""Draws the wiring diagram: nodes as boxes, data as lines, coloured by interposer."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path as Curve

from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.style import Figure, plain
from mast_zenoh.show.palette import ADVERSARY_ON_LIGHT, FAINT, FAULT_ON_LIGHT, INK, LOCAL, RUN_COLOURS
from mast_zenoh.show.tables.wiring import GAP, HIGH, ROW, WIDE, DiagramLayout, Spot, column_of, layout, live_frames

_HALF = WIDE / 2


def draw_wiring(run: Run) -> Figure | None:
    """The diagram of a run; None if wiring.json has no wire to draw."""
    plan = layout(run)
    if plan is None:
        return None
    xs, ys = [x for x, _ in plan.places.values()], [y for _, y in plan.places.values()]
    low, high = min(xs) - _HALF - 0.2, max(xs) + _HALF + 0.2
    top = min(ys) - HIGH
    figure = Figure(figsize=(high - low, plan.floor + 0.15 - top), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_xlim(low, high)
    axes.set_ylim(plan.floor + 0.15, top)
    axes.set_axis_off()
    for (source, target), line in sorted(plan.lines.items(), key=lambda item: (item[1].intercepted, item[1].linked)):
        hostile = line.intercepted or _is_attacker(run, source.node) or _is_attacker(run, target.node)
        colour = ADVERSARY_ON_LIGHT if hostile else FAULT_ON_LIGHT if line.linked else FAINT
        width = 1.9 if line.intercepted else 1.3 if line.linked else 1.0
        _draw_line(axes, _route(run, plan, source, target), colour, width)
    when = live_frames(run)
    for spot, (x, y) in plan.places.items():
        _draw_node(axes, run, spot.node, x, y, when.get(spot.node, ""))
    _name_lines(axes, run, plan)
    return figure


def _route(run: Run, plan: DiagramLayout, source: Spot, target: Spot) -> Curve:
    """The path of a line: bent where many lines meet, and straight past interposers."""
    (ax, ay), (bx, by) = plan.places[source], plan.places[target]
    if _is_above_flow(run, plan, source) or _is_above_flow(run, plan, target):  # to and from a node above the flow
        offset = 0.3 if ay < by else -0.3
        lift = HIGH / 2 if ay < by else -HIGH / 2
        return Curve([(ax + offset, ay + lift), (bx + offset, by - lift)])
    if bx < ax and ay == by:  # back to its own agent
        return Curve([(ax - _HALF, ay + 0.09), (bx + _HALF, by + 0.09)])
    if bx <= ax:  # back: down, along under everything, and up next to the target
        rise = bx + _HALF + 0.24
        points = [(ax, ay + HIGH / 2), (ax, plan.floor), (rise, plan.floor), (rise, by + 0.09), (bx + _HALF, by + 0.09)]
        return Curve(points)
    start, end = ax + _HALF, bx - _HALF
    fans_out = column_of(run, source.node) is not None and run.role(source.node) not in ("agent", "peer")
    bend = min(GAP, end - start) - 0.14  # leaves a level end for the arrowhead
    low, high = (start, start + bend) if fans_out else (end - 0.14 - bend, end - 0.14)
    middle = (low + high) / 2
    points = [(start, ay), (low, ay), (middle, ay), (middle, by), (high, by), (end, by)]
    return Curve(points, [Curve.MOVETO, Curve.LINETO, Curve.CURVE4, Curve.CURVE4, Curve.CURVE4, Curve.LINETO])


def _is_attacker(run: Run, node: str) -> bool:
    return run.role(node) in ("adversary", "coordinator")


def _is_above_flow(run: Run, plan: DiagramLayout, spot: Spot) -> bool:
    """Whether a node is drawn above the flow."""
    return column_of(run, spot.node) is None and plan.places[spot][1] <= -1.2 * ROW


def _draw_line(axes: Axes, route: Curve, colour: str, width: float) -> None:
    style: dict[str, Any] = {"arrowstyle": "-|>,head_length=5,head_width=2.5", "linewidth": width, "zorder": 1}
    axes.add_patch(FancyArrowPatch(path=route, edgecolor=colour, facecolor=colour, shrinkA=0, shrinkB=0, **style))


def _draw_node(axes: Axes, run: Run, node: str, x: float, y: float, when: str) -> None:
    """Draw a node as a box with its name; `when`: frames of a live interposer, or ""."""
    role, hostile = run.role(node), _is_attacker(run, node)
    edges, faces = {"agent": RUN_COLOURS[0], "link": FAULT_ON_LIGHT}, {"agent": "#eef5fb", "link": "#fbf6ea"}
    edge = ADVERSARY_ON_LIGHT if hostile else edges.get(role, INK)
    face = "#fdeef9" if hostile else faces.get(role, "#f6f7f9")
    box = (x - _HALF, y - HIGH / 2), WIDE, HIGH
    rounded = "round,pad=0,rounding_size=0.07"
    style: dict[str, Any] = {"facecolor": face, "edgecolor": edge, "linewidth": 1.2, "zorder": 2}
    axes.add_patch(FancyBboxPatch(*box, boxstyle=rounded, linestyle="--" if when else "-", **style))
    words: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 3}
    if when:
        ground = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
        axes.text(x, y - HIGH / 2 - 0.09, when, fontsize=7.5, color=edge, bbox=ground, **words)
    label = node if len(node) <= 20 else node[:18] + "…"
    axes.text(x, y, plain(label), fontsize=9.5, color=edge if hostile else INK, **words)


def _name_lines(axes: Axes, run: Run, plan: DiagramLayout) -> None:
    """Label lines once per gap between columns, and lines back and above the flow."""
    columns = sorted({x for spot, (x, _) in plan.places.items() if column_of(run, spot.node) is not None})
    labels: dict[tuple[float, float, str, str], list[str]] = {}
    for (source, target), line in plan.lines.items():
        (ax, ay), (bx, by) = plan.places[source], plan.places[target]
        if _is_above_flow(run, plan, source) or _is_above_flow(run, plan, target):
            x, y = (ax, ay) if ay < by else (bx, by)
            place = (x + 0.36, y + HIGH, "left", "center") if ay < by else (x - 0.36, y + HIGH, "right", "center")
        elif bx <= ax:
            place = ax - 0.1, plan.floor - 0.05, "right", "bottom"
        else:
            left = max((x for x in columns if x <= ax), default=ax)
            right = min((x for x in columns if x >= bx), default=bx)
            if any(left < x < right for x in columns):  # passes a whole column: named in the gap that it starts in
                continue
            place = (left + right) / 2 + 0.5, plan.floor - 0.42, "center", "center"
        messages_at_place = labels.setdefault(place, [])
        messages_at_place += [message for message in line.messages if message not in messages_at_place]
    for (x, y, horizontal, vertical), messages in labels.items():
        style: dict[str, Any] = {"fontsize": 9, "style": "italic", "color": LOCAL, "zorder": 3}
        ground = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
        axes.text(x, y, plain(", ".join(sorted(messages))), ha=horizontal, va=vertical, bbox=ground, **style)
