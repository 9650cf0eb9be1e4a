"""The legend of a film: everything that appears in one of its images."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from matplotlib import figure as figures
from matplotlib.artist import Artist
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mast_zenoh.report.figures.style import OUTCOME_LABELS
from mast_zenoh.report.figures.view import FrameView
from mast_zenoh.report.film.attacks import Attacks
from mast_zenoh.report.film.look import TRUTH
from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.film.theme import Theme
from mast_zenoh.report.trust_facts import states_at, withheld_at

#: In the order of the legend.
_OUTCOMES = ("truth matched", "track matched", "truth missed", "track false", "unevaluated")
#: Inches for each point of the font's size: width of a letter, of an entry's symbol and gaps; height of a line.
_LETTER, _ENTRY, _LINE = 0.0081, 0.056, 0.0235
#: Inches, least width of a figure with text of the ordinary size; points, that size and the one of narrow figures.
_NARROW, _SIZE, _SMALL_SIZE = 5.0, 9.0, 7.0


def entries(takes: Sequence[Take], attacks: Sequence[Attacks], frames: Sequence[int], theme: Theme) -> list[Artist]:
    """The entries for all that the panels show in these frames of the first take."""
    views = [(take, take.view(take.frame_at(takes[0].seconds(frame)))) for take in takes for frame in frames]
    shown = {name for take, view in views for name, boxes in view.boxes[take.estimate].items() if len(boxes)}
    if all(take.estimate == TRUTH for take in takes):
        handles: list[Artist] = [Patch(facecolor="none", edgecolor=theme.outcomes["truth matched"], label="object")]
    else:
        handles = [_outcome(name, theme) for name in _OUTCOMES if name != "unevaluated" or name in shown]
    if any(take.run.recording is not None for take in takes):
        states = {state for take, view in views for state in states_at(take.run, view.frame).values()}
        colour = theme.withheld if states else theme.agent
        kinds = {agent.kind for take in takes if take.run.recording for agent in take.run.recording.agents}
        handles += [_mark("o", colour, "vehicle with sensors", hollow=True)] if kinds - {"static"} else []
        handles += [_mark("^", colour, "roadside sensor")] if "static" in kinds else []
        handles += [_mark("^", theme.states[state], f"{state} agent") for state in theme.states if state in states]
    return handles + _conduct(views, attacks, theme)


def _conduct(views: Sequence[tuple[Take, FrameView]], attacks: Sequence[Attacks], theme: Theme) -> list[Artist]:
    handles: list[Artist] = []
    if any(each.possible for each in attacks):
        handles.append(_mark("^", theme.adversary, "adversary on its wire"))
        band = Patch(facecolor=to_rgba(theme.adversary, 0.28), edgecolor=theme.adversary, label="attack")
        handles.append(band)
    if any(len(withheld_at(view.run, view.frame)[2]) for _, view in views):
        handles.append(Patch(facecolor="none", edgecolor=theme.withheld, linestyle="--", label="withheld"))
    marks = [view.marks(take.estimate) for take, view in views]
    for kind, marker, label in (
        ("added", "D", "inserted by adversary"),
        ("removed", "x", "removed by adversary"),
        ("moved", "$\\rightarrow$", "moved by adversary"),
    ):
        if any(len(getattr(each, kind)) for each in marks):
            handles.append(_mark(marker, theme.adversary, label, hollow=marker == "D"))
    return handles


def lines(handles: Sequence[Artist], width: float) -> int:
    """Lines that entries need in a width in inches."""
    points = width / _font_size(width)
    return next((count for count in range(1, len(handles)) if _breadth(handles, count) <= points), len(handles))


def height(handles: Sequence[Artist], width: float) -> float:
    """Inches that entries need in a width in inches."""
    return _LINE * _font_size(width) * lines(handles, width)


def _font_size(width: float) -> float:
    return _SIZE if width >= _NARROW else _SMALL_SIZE


def _breadth(handles: Sequence[Artist], count: int) -> float:
    """Width of a legend of so many lines, inches for each point of the font's size.

    Matplotlib fills it column by column, the first ones the fullest.
    """
    columns = -(-len(handles) // count)
    full, left = divmod(len(handles), columns)
    ends = [full * column + min(column, left) for column in range(columns + 1)]
    widths = [[_width(each) for each in handles[start:end]] for start, end in pairwise(ends)]
    return sum(max(column) for column in widths if column)


def draw(figure: figures.Figure, handles: Sequence[Artist], theme: Theme) -> None:
    """Put entries at the bottom of a figure."""
    count = lines(handles, figure.get_figwidth())
    figure.legend(
        handles=list(handles),
        loc="lower center",
        ncols=-(-len(handles) // count),
        frameon=False,
        labelcolor=theme.ink,
        fontsize=_font_size(figure.get_figwidth()),
        handlelength=1.3,
        columnspacing=1.3,
        labelspacing=0.4,
        borderaxespad=0.2,
    )


def _width(entry: Artist) -> float:
    return _ENTRY + _LETTER * len(str(entry.get_label()))


def _outcome(name: str, theme: Theme) -> Patch:
    colour = theme.outcomes[name]
    face = to_rgba(colour, 0.35 if name in ("truth missed", "track false") else 0.0)
    return Patch(facecolor=face, edgecolor=colour, linewidth=1.5, label=OUTCOME_LABELS[name])


def _mark(marker: str, colour: str, label: str, *, hollow: bool = False) -> Line2D:
    face = "none" if hollow else colour
    return Line2D([], [], linestyle="", marker=marker, ms=7, mfc=face, mec=colour, mew=1.5, label=label)
