"""Which figures a report has, each with what it shows in words and what to know when looking at it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mast_zenoh.report.comparison import Reference
from mast_zenoh.report.figures.causes import causes_over_time
from mast_zenoh.report.figures.charts import SMOOTH, counts_over_time, means
from mast_zenoh.report.figures.diagram import draw_wiring
from mast_zenoh.report.figures.drawing import Picture, birdseye_figure, camera_figure, picture, side_by_side_figure
from mast_zenoh.report.figures.view import FrameView
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.driving import driving_over_time
from mast_zenoh.report.tables.interposers import interposers
from mast_zenoh.report.tables.scores import ESTIMATES, MEASURES, ScoreTable, number

_HOW_CHOSEN_ATTACKED = (
    "The frame is the scored one, since the first change by an adversary, with the most errors {where}{beyond}"
)
_HOW_CHOSEN_CLEAN = "The frame is the scored one in which the picture spares the ego the most errors"
_COUNTS_CAPTION = (
    f"Bold: mean over the last {SMOOTH} frames; pale: single frames. Shaded: from the first to the last change that an "
    "adversary made. The vertical line is the frame shown. The axes fit the scored frames; more is cut."
)
_BANDS_CAPTION = " Above: what was planned, each from its beginning to its end. Hatched: while any fault was on."
_DRIVING_CAPTION = (
    "Open loop: the ego keeps to the path that it drove in the scene, and at each moment looks at what is in its "
    "corridor. Times to collision above 10 s are not drawn. Wrong objects: false and missed ones."
)
_FULL_NAMES = {"local": "The ego alone", "picture": "The common picture", "mission": "The ego with the picture"}
_WORDS = (("fn", "missed"), ("fp", "false"), ("tp", "matched"))
_CAUSES_CAPTION = (
    "The common picture as the ego gets it, in every frame, stacked by cause: grey what happens anyway, hatched what "
    "links and faults have done, magenta what adversaries have. The axes fit the scored frames; more is cut."
)


def run_figures(
    run: RunFolder, view: FrameView | None, *, how: str, reference: Reference | None = None, estimate: str = "picture"
) -> dict[str, Picture]:
    """The figures of one run by name; those whose data are absent are left out.

    view: the frame that the pictures show; None: none can be shown
    how:  how the frame was chosen, in a sentence; empty: it is not said
    reference: the run that it is compared with, over time in `estimate`
    """
    made = []
    if view is not None:
        tally = ". ".join(f"{ESTIMATES[name].capitalize()}: {_tally(view, name)}" for name in view.boxes)
        alt = f"Bird's-eye view, {view.time_label}. {tally}."
        caption = (
            f"From above, around the ego: what it tracks from its own sensors, {_the_picture(view)}, and both "
            "together, by which it acts. The tick on a box points ahead; a wedge shows where a roadside sensor looks, "
            "not how far."
        )
        made.append(picture("birdseye", birdseye_figure(view), alt, f"{caption} {how}".strip()))
        seat = camera_figure(view)
        if seat is not None:
            alt = f"The ego's camera view, {view.time_label}: its own tracks above, with the picture below."
            caption = (
                "The same frame through the ego's camera (the middle strip of its image). Boxes are drawn through "
                "walls and through each other: what the ego's own sensors cannot see, the picture can show."
            )
            made.append(picture("camera", seat, alt, caption))
    runs = {reference.name: reference.run, run.label: run} if reference is not None else {run.label: run}
    over_time = counts_over_time(runs, view.frame if view else None, estimate)
    if over_time is not None:
        alt = "Missed objects, false objects and RMSE over time, for the ego alone, the picture and both together."
        made.append(picture("counts", over_time, alt, _counts_caption([run])))
    causes = causes_over_time(run, view.frame if view else None)
    if causes is not None:
        alt = "Missed and false objects of the common picture over time, stacked by their causes."
        made.append(picture("causes", causes, alt, _CAUSES_CAPTION))
    drive = driving_over_time(run, view.frame if view else None)
    if drive is not None:
        alt = "Time to collision, wrong objects in the corridor and braking over time: truth, ego alone, with picture."
        made.append(picture("driving", drive, alt, _DRIVING_CAPTION))
    wires = draw_wiring(run)
    if wires is not None:
        hostile = [each for each in interposers(run) if not each.is_link]
        places = [f"{each.description} on {each.place}" for each in hostile]
        alt = f"Diagram of the nodes and the data between them. {'; '.join(places) or 'No adversary'}."
        caption = "Not drawn: the clock, which every node gets, and the wires of nodes that only listen."
        if hostile:
            caption = f"Bold: intercepted wires. {caption}"
        if any(each.live is not None for each in hostile):
            caption = f"{caption} Nodes with a broken edge were put on their wire while the run went on."
        if any(each.is_link for each in interposers(run)):
            caption = f"Brown: wires with a link on them. {caption}"
        made.append(picture("wiring", wires, alt, caption, vector=True))
    return {each.name: each for each in made}


def study_figures(
    runs: Mapping[str, RunFolder],
    table: ScoreTable,
    views: Mapping[str, FrameView],
    estimate: str = "picture",
    *,
    chosen: bool,
) -> dict[str, Picture]:
    """The figures that compare runs, by name."""
    made = []
    if views:
        told = "; ".join(f"{label}: {_tally(view, estimate)}" for label, view in views.items())
        name = _FULL_NAMES[estimate]
        caption = f"{name} in the same frame of every run; under it, means per frame over the scored frames."
        if chosen:
            beyond = f" less those of {table.reference} in the same frame"
            caption += f" {_HOW_CHOSEN_ATTACKED.format(where=f'of the {ESTIMATES[estimate]}', beyond=beyond)}."
        alt = f"Bird's-eye views side by side, {next(iter(views.values())).time_label}. {told}."
        made.append(picture("side_by_side", side_by_side_figure(views, table, estimate), alt, caption))
    over_time = counts_over_time(runs, next(iter(views.values())).frame if views else None, estimate)
    if over_time is not None:
        alt = f"Missed objects, false objects and RMSE over time: ego alone, and {ESTIMATES[estimate]} of every run."
        made.append(picture("counts", over_time, alt, _counts_caption(list(runs.values()))))
    if any(row.cells for row in table.rows):
        keys = {measure.key: measure for measure in MEASURES}
        texts = [
            f"{run}: "
            + ", ".join(f"{number(table.cell(key, run, estimate).value, keys[key])} {word}" for key, word in _WORDS)
            for run in table.runs
        ]
        caption = "Means per frame; whiskers: \u00b1 one standard deviation over frames."
        made.append(picture("means", means(table, estimate), f"Bar chart. {'; '.join(texts)}.", caption))
    return {each.name: each for each in made}


def how_chosen(run: RunFolder, estimate: str, reference: str = "") -> str:
    """How a frame was chosen, in a sentence; reference: the run whose errors were taken off, in words."""
    if not run.attack_frames and not reference:
        return f"{_HOW_CHOSEN_CLEAN}."
    beyond = f" beyond those of {reference} in the same frame" if reference else ""
    sentence = _HOW_CHOSEN_ATTACKED.format(where=f"of the {ESTIMATES.get(estimate, estimate)}", beyond=beyond)
    return (
        sentence.replace(", since the first change by an adversary,", "") + "."
        if not run.attack_frames
        else f"{sentence}."
    )


def _the_picture(view: FrameView) -> str:
    """Which picture a view shows, in words."""
    ways = {"picture_received": "as the ego receives it", "picture_on_arrival": "when it reaches the ego"}
    shown = next((way for name, way in ways.items() if name in view.boxes), "")
    return f"the common picture {shown}".strip()


def _counts_caption(runs: Sequence[RunFolder]) -> str:
    return _COUNTS_CAPTION + (_BANDS_CAPTION if any(run.faulted and run.timeline for run in runs) else "")


def _tally(view: FrameView, estimator: str) -> str:
    boxes = view.boxes[estimator]
    return (
        f"{len(boxes['truth missed'])} missed, {len(boxes['track false'])} false, {len(boxes['truth matched'])} matched"
    )
