"""Which figures a report has, each with what it shows in words and what to know when looking at it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mast_zenoh.report.causes import causes_over_time
from mast_zenoh.report.charts import SMOOTH, counts_over_time, means
from mast_zenoh.report.diagram import draw_wiring
from mast_zenoh.report.figures import Picture, birdseye_figure, camera_figure, picture, side_by_side_figure
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.table import Scores, SummaryRow
from mast_zenoh.report.view import FrameView

_HOW_CHOSEN_ATTACKED = (
    "The frame is the one, since the first change by an adversary, "
    "with the most missed and false objects in the picture"
)
_HOW_CHOSEN_CLEAN = "The frame is the one in which the picture spares the ego the most missed and false objects"
_COUNTS_CAPTION = (
    f"Bold: mean over the last {SMOOTH} frames; pale: the counts themselves. Shaded: from the first to the last change "
    "that an adversary made. The vertical line is the frame shown."
)
_BANDS_CAPTION = " Above: what was planned, each from its beginning to its end. Hatched: while any fault was on."
_CAUSES_CAPTION = (
    "The common picture as the ego gets it, in every frame, stacked by cause: grey what happens anyway, hatched what "
    "links and faults have done, magenta what adversaries have. The axes fit the scored frames; more is cut."
)


def run_figures(run: RunFolder, view: FrameView | None, *, chosen: bool) -> dict[str, Picture]:
    """The figures of one run by name; those whose data are absent are left out.

    view:   the frame that the pictures show; None: none can be shown
    chosen: the frame was chosen by rule, which the caption then states
    """
    made = []
    if view is not None:
        how = f" {_HOW_CHOSEN_ATTACKED if run.attack_frames else _HOW_CHOSEN_CLEAN}." if chosen else ""
        tally = {name: _tally(view, name) for name in ("local", "picture")}
        above = birdseye_figure(view)
        alt = f"Bird's-eye view, {view.time_label}. Own tracks: {tally['local']}. Picture: {tally['picture']}."
        caption = (
            "From above, around the ego: what it tracks from its own sensors (left) and the common picture (right). "
            f"The tick on a box points ahead; a wedge shows where a roadside sensor looks, not how far.{how}"
        )
        made.append(picture("birdseye", above, alt, caption))
        seat = camera_figure(view)
        if seat is not None:
            alt = f"The ego's camera view, {view.time_label}, with the same boxes: own tracks above, picture below."
            caption = (
                "The same frame through the ego's camera (the middle strip of its image). Boxes are drawn through "
                "walls and through each other: what the ego's own sensors cannot see, the picture can show."
            )
            made.append(picture("camera", seat, alt, caption))
    over_time = counts_over_time({"run": run}, view.frame if view else None)
    if over_time is not None:
        alt = "Missed, false and matched objects per frame over time, for the ego alone and for the common picture."
        made.append(picture("counts", over_time, alt, _counts_caption([run])))
    causes = causes_over_time(run, view.frame if view else None)
    if causes is not None:
        alt = "Missed and false objects of the common picture over time, stacked by their causes."
        made.append(picture("causes", causes, alt, _CAUSES_CAPTION))
    wires = draw_wiring(run)
    if wires is not None:
        told = [f"{', '.join(nodes)} on a wire of {agent}" for agent, nodes in run.adversaries.items()]
        alt = f"Diagram of the nodes and the data between them. {'; '.join(told) or 'No adversary'}."
        caption = "Not drawn: the clock, which every node gets, and the wires of nodes that only listen."
        if told:
            caption = f"Bold: intercepted wires. {caption}"
        if any(
            run.role(node) == "link" for wire in run.wiring.get("wires", ()) for node in wire.get("interposers", ())
        ):
            caption = f"Brown: wires with a link on them. {caption}"
        made.append(picture("wiring", wires, alt, caption, vector=True))
    return {each.name: each for each in made}


def study_figures(
    runs: Mapping[str, RunFolder],
    rows: Sequence[SummaryRow],
    views: Mapping[str, FrameView],
    reference: str,
    *,
    chosen: bool,
) -> dict[str, Picture]:
    """The figures that compare runs, by name; `reference` labels the run that the others are compared with."""
    made = []
    if views:
        told = "; ".join(f"{label}: {_tally(view, 'picture')}" for label, view in views.items())
        caption = "The common picture of the same frame in every run; under it, means per frame over the scored frames."
        if chosen:
            caption += f" {_HOW_CHOSEN_ATTACKED}, less those of {reference} in the same frame."
        alt = f"Bird's-eye views side by side, {next(iter(views.values())).time_label}. {told}."
        made.append(picture("side_by_side", side_by_side_figure(views, rows), alt, caption))
    over_time = counts_over_time(runs, next(iter(views.values())).frame if views else None)
    if over_time is not None:
        alt = (
            "Missed, false and matched objects per frame over time, for the ego alone and for the picture of every run."
        )
        made.append(picture("counts", over_time, alt, _counts_caption(list(runs.values()))))
    if any(row.picture != Scores() for row in rows):
        alt = "; ".join(
            f"{row.run}: {row.picture.fn} missed, {row.picture.fp} false, {row.picture.tp} matched" for row in rows
        )
        caption = "Means per frame; whiskers: ± one standard deviation over frames."
        made.append(picture("means", means(rows, f"ego alone, {rows[0].run}"), f"Bar chart. {alt}.", caption))
    return {each.name: each for each in made}


def _counts_caption(runs: Sequence[RunFolder]) -> str:
    return _COUNTS_CAPTION + (_BANDS_CAPTION if any(run.faulted and run.timeline for run in runs) else "")


def _tally(view: FrameView, estimator: str) -> str:
    boxes = view.boxes[estimator]
    return (
        f"{len(boxes['truth missed'])} missed, {len(boxes['track false'])} false, {len(boxes['truth matched'])} matched"
    )
