"""The figures of a report, each with its alt text and caption."""

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

_CHOICE_ATTACKED = (
    "The frame is the scored one, since the first change by an adversary, with the most errors {where}{beyond}"
)
_CHOICE_CLEAN = "The frame is the scored one in which the picture spares the ego the most errors"
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
    run: RunFolder,
    view: FrameView | None,
    *,
    frame_note: str,
    reference: Reference | None = None,
    estimate: str = "picture",
) -> dict[str, Picture]:
    """The figures of one run by name, without those whose data are absent.

    view: the frame that pictures show; None: no pictures
    frame_note: how the frame was chosen, in a sentence; may be empty
    reference: the run that it is compared with in charts over time of `estimate`
    """
    figures = []
    if view is not None:
        tally = ". ".join(f"{ESTIMATES[name].capitalize()}: {_tally(view, name)}" for name in view.boxes)
        alt = f"Bird's-eye view, {view.time_label}. {tally}."
        caption = (
            f"From above, around the ego: what it tracks from its own sensors, {_the_picture(view)}, and both "
            "together, by which it acts. The tick on a box points ahead; a wedge shows where a roadside sensor looks, "
            "not how far."
        )
        figures.append(picture("birdseye", birdseye_figure(view), alt, f"{caption} {frame_note}".strip()))
        camera = camera_figure(view)
        if camera is not None:
            alt = f"The ego's camera view, {view.time_label}: its own tracks above, with the picture below."
            caption = (
                "The same frame through the ego's camera (the middle strip of its image). Boxes are drawn through "
                "walls and through each other: what the ego's own sensors cannot see, the picture can show."
            )
            figures.append(picture("camera", camera, alt, caption))
    runs = {reference.name: reference.run, run.label: run} if reference is not None else {run.label: run}
    over_time = counts_over_time(runs, view.frame if view else None, estimate)
    if over_time is not None:
        alt = "Missed objects, false objects and RMSE over time, for the ego alone, the picture and both together."
        figures.append(picture("counts", over_time, alt, _counts_caption([run])))
    causes = causes_over_time(run, view.frame if view else None)
    if causes is not None:
        alt = "Missed and false objects of the common picture over time, stacked by their causes."
        figures.append(picture("causes", causes, alt, _CAUSES_CAPTION))
    driving = driving_over_time(run, view.frame if view else None)
    if driving is not None:
        alt = "Time to collision, wrong objects in the corridor and braking over time: truth, ego alone, with picture."
        figures.append(picture("driving", driving, alt, _DRIVING_CAPTION))
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
        figures.append(picture("wiring", wires, alt, caption, vector=True))
    return {each.name: each for each in figures}


def study_figures(
    runs: Mapping[str, RunFolder],
    table: ScoreTable,
    views: Mapping[str, FrameView],
    estimate: str = "picture",
    *,
    chosen: bool,
) -> dict[str, Picture]:
    """The figures that compare runs, by name."""
    figures = []
    if views:
        tallies = "; ".join(f"{label}: {_tally(view, estimate)}" for label, view in views.items())
        name = _FULL_NAMES[estimate]
        caption = f"{name} in the same frame of every run; under it, means per frame over the scored frames."
        if chosen:
            beyond = f" less those of {table.reference} in the same frame"
            caption += f" {_CHOICE_ATTACKED.format(where=f'of the {ESTIMATES[estimate]}', beyond=beyond)}."
        alt = f"Bird's-eye views side by side, {next(iter(views.values())).time_label}. {tallies}."
        figures.append(picture("side_by_side", side_by_side_figure(views, table, estimate), alt, caption))
    over_time = counts_over_time(runs, next(iter(views.values())).frame if views else None, estimate)
    if over_time is not None:
        alt = f"Missed objects, false objects and RMSE over time: ego alone, and {ESTIMATES[estimate]} of every run."
        figures.append(picture("counts", over_time, alt, _counts_caption(list(runs.values()))))
    if any(row.cells for row in table.rows):
        keys = {measure.key: measure for measure in MEASURES}
        texts = [
            f"{run}: "
            + ", ".join(f"{number(table.cell(key, run, estimate).value, keys[key])} {word}" for key, word in _WORDS)
            for run in table.runs
        ]
        caption = "Means per frame; whiskers: \u00b1 one standard deviation over frames."
        figures.append(picture("means", means(table, estimate), f"Bar chart. {'; '.join(texts)}.", caption))
    return {each.name: each for each in figures}


def frame_choice(run: RunFolder, estimate: str, reference: str = "") -> str:
    """A sentence that explains how a frame was chosen.

    reference: name of the run whose errors were subtracted
    """
    if not run.attack_frames and not reference:
        return f"{_CHOICE_CLEAN}."
    beyond = f" beyond those of {reference} in the same frame" if reference else ""
    sentence = _CHOICE_ATTACKED.format(where=f"of the {ESTIMATES.get(estimate, estimate)}", beyond=beyond)
    return (
        sentence.replace(", since the first change by an adversary,", "") + "."
        if not run.attack_frames
        else f"{sentence}."
    )


def _the_picture(view: FrameView) -> str:
    """The picture that a view shows, in words."""
    variants = {"picture_received": "as the ego receives it", "picture_on_arrival": "when it reaches the ego"}
    variant = next((way for name, way in variants.items() if name in view.boxes), "")
    return f"the common picture {variant}".strip()


def _counts_caption(runs: Sequence[RunFolder]) -> str:
    return _COUNTS_CAPTION + (_BANDS_CAPTION if any(run.faulted and run.timeline for run in runs) else "")


def _tally(view: FrameView, estimator: str) -> str:
    boxes = view.boxes[estimator]
    return (
        f"{len(boxes['truth missed'])} missed, {len(boxes['track false'])} false, {len(boxes['truth matched'])} matched"
    )
