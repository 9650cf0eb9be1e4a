"""The figures of one run and of compared runs: ours and those of users, with alt texts and captions."""

from __future__ import annotations

import copy
import json
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure as MatplotlibFigure

from mast_zenoh.config import loading, plugins
from mast_zenoh.errors import RunFolderError
from mast_zenoh.mesh.control.failures import described, location
from mast_zenoh.metrics.estimates import ESTIMATES, IN_TRANSIT, LOCAL, PICTURE, column_name
from mast_zenoh.run_folder import check_plain, read_json, write_bytes
from mast_zenoh.runs.events import doubts, states_at, suspensions
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.interposers import hostile, interposers
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures import drawing
from mast_zenoh.show.figures.diagram import draw_wiring
from mast_zenoh.show.figures.driven import driven_figure
from mast_zenoh.show.figures.over_time import SMOOTH, causes_over_time, counts_over_time, driving_over_time
from mast_zenoh.show.figures.plots import trust_over_time
from mast_zenoh.show.figures.style import Figure
from mast_zenoh.show.findings.cars import of_cars
from mast_zenoh.show.findings.words import capital
from mast_zenoh.show.findings.words import text as said_in_text
from mast_zenoh.show.run_figure import SECTIONS, FigureContext, RunFigure
from mast_zenoh.show.tables.scores import ScoreTable

_COUNTS_CAPTION = (
    f"Bold: mean over the last {SMOOTH} frames; pale: single frames. Shaded: from the first to the last change that an "
    "adversary made. The vertical line is the frame shown. The axes fit the scored frames; more is cut."
)
_BANDS_CAPTION = " Above: what was planned, each from its beginning to its end. Hatched: while any fault was active."


class Birdseye(RunFigure):
    """The ego's surroundings from above: its own tracks, the picture, and both."""

    def draw(self, context: FigureContext) -> Figure | None:
        return None if context.view is None else drawing.birdseye_figure(context.view)

    def alt(self, context: FigureContext) -> str:
        assert context.view is not None
        view = context.view
        tallies = ". ".join(f"{ESTIMATES[name].column.capitalize()}: {tally(view, name)}" for name in view.boxes)
        return f"Bird's-eye view, {view.time_label}. {tallies}."

    def caption(self, context: FigureContext) -> str:
        assert context.view is not None
        caption = (
            f"From above, around the ego: what it tracks from its own sensors, {_the_picture(context.view)}, and both "
            "together, on which it acts. The tick on a box points ahead; thin lines are the limits of sensors."
        )
        if states_at(context.view.run, context.view.index):
            caption += (
                " Agents have the colour of their state at the command centre; dashed: objects that it withholds."
            )
        return f"{caption} {context.frame_note}".strip()


class CameraFigure(RunFigure):
    """The same frame through the ego's camera (the middle strip of its image). The front of each box is filled.
    Boxes are drawn through walls: what the ego's own sensors cannot see, the picture can show.
    """

    name = "camera"

    def draw(self, context: FigureContext) -> Figure | None:
        return None if context.view is None else drawing.camera_figure(context.view)

    def alt(self, context: FigureContext) -> str:
        assert context.view is not None
        return f"The ego's camera view, {context.view.time_label}: its own tracks above, with the picture below."


class CountsFigure(RunFigure):
    """Missed and false objects and RMSE over time, next to the reference run's."""

    name = "counts"

    def draw(self, context: FigureContext) -> Figure | None:
        reference = context.reference
        runs = {reference.name: reference.run} if reference is not None else {}
        return counts_over_time(runs | {context.run.name: context.run}, context.frame, context.estimate)

    def alt(self, context: FigureContext) -> str:
        return "Missed objects, false objects and RMSE over time, for the ego alone, the picture and both together."

    def caption(self, context: FigureContext) -> str:
        return counts_caption([context.run])


class Causes(RunFigure):
    """The common picture as the ego gets it, in every frame, stacked by cause: grey what happens anyway, hatched what
    links and faults have done, magenta what adversaries have. The axes fit the scored frames; more is cut.
    """

    def draw(self, context: FigureContext) -> Figure | None:
        return causes_over_time(context.run, context.frame)

    def alt(self, context: FigureContext) -> str:
        return "Missed and false objects of the common picture over time, stacked by their causes."


class Driven(RunFigure):
    """Where the driven car drove, and its speed and acceleration. Squares and bands: it brakes (harder than 1.3 m/s²);
    red: needlessly. Dots: where it is at the end.
    """

    def draw(self, context: FigureContext) -> Figure | None:
        return driven_figure(context.run, context.reference)

    def alt(self, context: FigureContext) -> str:
        happened = said_in_text(context.run, of_cars(context.run, context.reference))
        return f"Path, speed and acceleration of the driven car. {happened}"

    def caption(self, context: FigureContext) -> str:
        caption = super().caption(context)
        return caption if context.reference is None else f"{caption} Broken lines: {context.reference.name}."


class DrivingFigure(RunFigure):
    """Open loop: the ego keeps to the path that it drove in the scene, and at each moment looks at what is in its
    corridor. Times to collision above 10 s are not drawn. Wrong objects: false and missed ones.
    """

    name = "driving"

    def draw(self, context: FigureContext) -> Figure | None:
        return driving_over_time(context.run, context.frame)

    def alt(self, context: FigureContext) -> str:
        return "Time to collision, wrong objects in the corridor and braking over time: truth, ego alone, with picture."


class WiringFigure(RunFigure):
    """The nodes and the data between them."""

    name = "wiring"
    vector = True

    def draw(self, context: FigureContext) -> Figure | None:
        return draw_wiring(context.run)

    def alt(self, context: FigureContext) -> str:
        places = [f"{each.description} on {each.place}" for each in hostile(context.run)]
        return f"Diagram of the nodes and the data between them. {'; '.join(places) or 'No adversary'}."

    def caption(self, context: FigureContext) -> str:
        on_wires, adversaries = interposers(context.run), hostile(context.run)
        caption = "Not drawn: clock, truth and attack reports, and lines to an evaluator, a recorder or a visualizer."
        if adversaries:
            caption = f"Bold: intercepted wires. {caption}"
        if any(each.live is not None for each in adversaries):
            caption = f"{caption} Nodes with a broken edge were inserted into their wire during the run."
        if len(adversaries) < len(on_wires):
            caption = f"Brown: wires with a link on them. {caption}"
        return caption


class TrustFigure(RunFigure):
    """The command centre's trust in each agent, and when it was suspended, undecided or taken to be faulty. Below each
    line: when adversaries changed what the agent sent, as measured on its wires, and when faults of the timeline acted
    on it.
    """

    name = "trust"

    def draw(self, context: FigureContext) -> Figure | None:
        return trust_over_time(context.run, context.frame)

    def alt(self, context: FigureContext) -> str:
        suspended, undecided = (
            "; ".join(
                f"{each['agent']} from {each['from_s']:.1f} s to "
                + ("the end" if each["until_s"] is None else f"{each['until_s']:.1f} s")
                for each in periods
            )
            for periods in (suspensions(context.run), doubts(context.run))
        )
        text = f"Trust in each agent over time. Suspended: {suspended or 'no agent'}."
        return f"{text} Undecided: {undecided}." if undecided else text


#: In the order in which they are drawn. The page has a place for each.
OURS: tuple[type[RunFigure], ...] = (
    Birdseye,
    TrustFigure,
    CameraFigure,
    CountsFigure,
    Causes,
    Driven,
    DrivingFigure,
    WiringFigure,
)


def run_figures(context: FigureContext) -> dict[str, drawing.RenderedFigure]:
    """Our figures of one run by name, without those whose data are absent."""
    pictures = (rendered(kind(), context) for kind in OURS)
    return {each.name: each for each in pictures if each is not None}


def rendered(figure: RunFigure, context: FigureContext) -> drawing.RenderedFigure | None:
    """A figure as it goes into the page; None if there is nothing to draw."""
    drawn = figure.draw(context)
    if drawn is None:
        return None
    if not isinstance(drawn, MatplotlibFigure):
        raise TypeError(f"draw returned {type(drawn).__name__}, expected a Matplotlib figure or None")
    return drawing.render(figure.label(), drawn, figure.alt(context), figure.caption(context), vector=figure.vector)


def _the_picture(view: Frame) -> str:
    """The picture that a view shows, in words."""
    name = next((name for name in IN_TRANSIT if name in view.boxes), PICTURE)
    return ESTIMATES[name].panel.replace("the picture", "the common picture")


def counts_caption(runs: Sequence[Run]) -> str:
    """How to read the counts of runs over time."""
    return _COUNTS_CAPTION + (_BANDS_CAPTION if any(run.faulted and run.timeline for run in runs) else "")


def tally(view: Frame, estimator: str) -> str:
    """The numbers of boxes of an estimate in a frame, in words."""
    boxes = view.boxes[estimator]
    return (
        f"{len(boxes['truth missed'])} missed, {len(boxes['track false'])} false, {len(boxes['truth matched'])} matched"
    )


FILE = "user_figures.json"
_KEYS = ("name", "heading", "after", "alt", "caption")
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, slots=True)
class UserFigure:
    """A user's figure on the page.

    name, heading, after: see `RunFigure`
    picture: None where it could not be drawn
    problem: why not; "" where it could
    """

    name: str
    heading: str
    after: str
    picture: drawing.RenderedFigure | None
    problem: str = ""


def user_figures(context: FigureContext, files: Sequence[Path] = ()) -> list[UserFigure]:
    """The figures of users for the report of a run, by their names.

    files: files to load; loaded files of the scenario, and the plugins that it uses, are searched too
    Raises ConfigurationError for a file that cannot be loaded.
    """
    named = context.run.files.scenario.get("modules", ())
    modules = [loading.loaded_module(Path(name)) for name in named if isinstance(name, str)]
    modules += [loading.module(file) for file in files]
    kinds = loading.concrete((module for module in modules if module is not None), RunFigure)
    used = context.run.files.scenario.get("plugins")
    kinds += plugins.classes_for(used if isinstance(used, dict) else {}, RunFigure)
    if kinds:
        context = copy.deepcopy(context)  # so that no figure can change the rest of the page
    drawn: dict[str, UserFigure] = {}
    for kind in kinds:
        if (each := _drawn(kind, context, drawn)) is not None:
            drawn[each.name] = each
    figures = {each.name: each for each in _stored(context.folder / "figures")} | drawn
    return [figures[name] for name in sorted(figures)]


def save_user_figures(figures: Iterable[UserFigure], folder: Path) -> None:
    """Write the pictures and their texts into a folder, if there are any."""
    pictures = [(each, each.picture) for each in figures if each.picture is not None]
    for _, picture in pictures:
        picture.save(folder)
    if pictures:
        rows = [(each.name, each.heading, each.after, made.alt, made.caption) for each, made in pictures]
        content = [dict(zip(_KEYS, row, strict=True)) for row in rows]
        write_bytes(folder / FILE, (json.dumps(content, indent=2) + "\n").encode())


def _drawn(kind: type[RunFigure], context: FigureContext, taken: Container[str]) -> UserFigure | None:
    """A figure, or why it could not be drawn; None: it had nothing to draw.

    taken: the names of other figures
    """
    try:
        name, heading = _names(kind)
        if name in taken or name in {ours.label() for ours in OURS}:
            raise ValueError(f"name: found {name!r}, which another figure has")
        if kind.after not in SECTIONS:
            raise ValueError(f"after: found {kind.after!r}, expected one of {', '.join(SECTIONS)}")
        picture = rendered(kind(), context)
        if picture is not None and not (isinstance(picture.alt, str) and isinstance(picture.caption, str)):
            raise ValueError("alt and caption: expected a string")
    except (Exception, SystemExit) as error:
        problem = f"{kind.__name__} could not be drawn: {described(error)} ({location(error, kind.draw)})"
        return UserFigure(f"{kind.__module__}.{kind.__name__}", kind.__name__, RunFigure.after, None, problem)
    return None if picture is None else UserFigure(name, heading, kind.after, picture)


def _names(kind: type[RunFigure]) -> tuple[str, str]:
    """The name and the heading of a figure; raises ValueError for invalid ones."""
    for text in (kind.name, kind.heading):
        if not isinstance(text, str) or not text.isprintable():
            raise ValueError(f"name and heading: found {text!r}, expected printable text")
    name = kind.label()
    if not name.isidentifier():
        raise ValueError(f"name: found {name!r}, expected letters, digits and _")
    return name, kind.heading or name.replace("_", " ").capitalize()


def _stored(folder: Path) -> list[UserFigure]:
    """The figures that an earlier report has drawn; a broken one is left out."""
    try:
        content = read_json(folder / FILE)
    except RunFolderError:
        return []
    figures = []
    for entry in content if isinstance(content, list) else ():
        try:
            name, heading, after, alt, caption = (_text(entry, key) for key in _KEYS)
            png = check_plain(folder / f"{name}.png").read_bytes() if name.isidentifier() else b""
        except (OSError, ValueError, RunFolderError):
            continue
        if png.startswith(_PNG) and len(png) > 24 and after in SECTIONS:
            figures.append(UserFigure(name, heading, after, drawing.RenderedFigure(name, alt, caption, {"png": png})))
    return figures


def _text(entry: Any, key: str) -> str:
    value = entry.get(key) if isinstance(entry, dict) else None
    if not isinstance(value, str):
        raise ValueError(f"{key}: found {value!r:.40}, expected a string")
    return value


_CHOICE_ATTACKED = (
    "The frame is the scored one, since the first change by an adversary, with the most errors {where}{beyond}"
)
_CHOICE_CLEAN = "The frame is the scored one in which the picture spares the ego the most errors"


def study_figures(
    runs: Mapping[str, Run], table: ScoreTable, views: Mapping[str, Frame], estimate: str = "picture"
) -> dict[str, drawing.RenderedFigure]:
    """The figures that compare runs, by name."""
    figures = []
    if views:
        tallies = "; ".join(f"{label}: {tally(view, estimate)}" for label, view in views.items())
        name = capital(ESTIMATES[estimate].panel.partition(":")[0])
        caption = f"{name} in the same frame of every run; under it, means per frame over the scored frames."
        beyond = f" less those of {table.reference} in the same frame"
        caption += f" {_CHOICE_ATTACKED.format(where=f'of the {ESTIMATES[estimate].column}', beyond=beyond)}."
        alt = f"Bird's-eye views side by side, {next(iter(views.values())).time_label}. {tallies}."
        figures.append(
            drawing.render("side_by_side", drawing.side_by_side_figure(views, table, estimate), alt, caption)
        )
    over_time = counts_over_time(runs, next(iter(views.values())).index if views else None, estimate)
    if over_time is not None:
        names = tuple(ESTIMATES[each].column for each in (LOCAL, estimate))
        alt = f"Missed objects, false objects and RMSE over time: {names[0]}, and {names[1]} of every run."
        figures.append(drawing.render("counts", over_time, alt, counts_caption(list(runs.values()))))
    return {each.name: each for each in figures}


def frame_choice(run: Run, estimate: str, reference: str = "") -> str:
    """A sentence that explains how a frame was chosen.

    reference: name of the run whose errors were subtracted
    """
    if not run.attack_frames and not reference:
        return f"{_CHOICE_CLEAN}."
    beyond = f" beyond those of {reference} in the same frame" if reference else ""
    sentence = _CHOICE_ATTACKED.format(where=f"of the {column_name(estimate)}", beyond=beyond)
    return f"{sentence if run.attack_frames else sentence.replace(', since the first change by an adversary,', '')}."
