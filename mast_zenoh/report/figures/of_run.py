"""Our figures of one run."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure as MatplotlibFigure

from mast_zenoh.report.figures.causes import causes_over_time
from mast_zenoh.report.figures.charts import SMOOTH, counts_over_time
from mast_zenoh.report.figures.diagram import draw_wiring
from mast_zenoh.report.figures.drawing import RenderedFigure, birdseye_figure, camera_figure, render
from mast_zenoh.report.figures.driving import driving_over_time
from mast_zenoh.report.figures.style import Figure
from mast_zenoh.report.figures.trust import trust_over_time
from mast_zenoh.report.figures.view import FrameView
from mast_zenoh.report.run_figure import FigureContext, RunFigure
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import interposers
from mast_zenoh.report.tables.scores import ESTIMATES
from mast_zenoh.report.trust_facts import states_at, suspensions

_COUNTS_CAPTION = (
    f"Bold: mean over the last {SMOOTH} frames; pale: single frames. Shaded: from the first to the last change that an "
    "adversary made. The vertical line is the frame shown. The axes fit the scored frames; more is cut."
)
_BANDS_CAPTION = " Above: what was planned, each from its beginning to its end. Hatched: while any fault was active."


class Birdseye(RunFigure):
    """The ego's surroundings from above: its own tracks, the picture, and both."""

    def draw(self, context: FigureContext) -> Figure | None:
        return None if context.view is None else birdseye_figure(context.view)

    def alt(self, context: FigureContext) -> str:
        assert context.view is not None
        view = context.view
        tallies = ". ".join(f"{ESTIMATES[name].capitalize()}: {tally(view, name)}" for name in view.boxes)
        return f"Bird's-eye view, {view.time_label}. {tallies}."

    def caption(self, context: FigureContext) -> str:
        assert context.view is not None
        caption = (
            f"From above, around the ego: what it tracks from its own sensors, {_the_picture(context.view)}, and both "
            "together, on which it acts. The tick on a box points ahead; thin lines are the limits and "
            "the range of a roadside sensor."
        )
        if states_at(context.view.run, context.view.frame):
            caption += (
                " Agents have the colour of their state at the command centre; dashed: objects that it withholds."
            )
        return f"{caption} {context.frame_note}".strip()


class Camera(RunFigure):
    """The same frame through the ego's camera (the middle strip of its image). The front of each box is filled.
    Boxes are drawn through walls: what the ego's own sensors cannot see, the picture can show.
    """

    def draw(self, context: FigureContext) -> Figure | None:
        return None if context.view is None else camera_figure(context.view)

    def alt(self, context: FigureContext) -> str:
        assert context.view is not None
        return f"The ego's camera view, {context.view.time_label}: its own tracks above, with the picture below."


class Counts(RunFigure):
    """Missed and false objects and RMSE over time, next to the reference run's."""

    def draw(self, context: FigureContext) -> Figure | None:
        reference = context.reference
        runs = {reference.name: reference.run} if reference is not None else {}
        return counts_over_time(runs | {context.run.label: context.run}, context.frame, context.estimate)

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


class Driving(RunFigure):
    """Open loop: the ego keeps to the path that it drove in the scene, and at each moment looks at what is in its
    corridor. Times to collision above 10 s are not drawn. Wrong objects: false and missed ones.
    """

    def draw(self, context: FigureContext) -> Figure | None:
        return driving_over_time(context.run, context.frame)

    def alt(self, context: FigureContext) -> str:
        return "Time to collision, wrong objects in the corridor and braking over time: truth, ego alone, with picture."


class Wiring(RunFigure):
    """The nodes and the data between them."""

    vector = True

    def draw(self, context: FigureContext) -> Figure | None:
        return draw_wiring(context.run)

    def alt(self, context: FigureContext) -> str:
        places = [f"{each.description} on {each.place}" for each in interposers(context.run) if not each.is_link]
        return f"Diagram of the nodes and the data between them. {'; '.join(places) or 'No adversary'}."

    def caption(self, context: FigureContext) -> str:
        on_wires = interposers(context.run)
        hostile = [each for each in on_wires if not each.is_link]
        caption = "Not drawn: clock, truth and attack reports, and lines to an evaluator, a recorder or a visualizer."
        if hostile:
            caption = f"Bold: intercepted wires. {caption}"
        if any(each.live is not None for each in hostile):
            caption = f"{caption} Nodes with a broken edge were inserted into their wire during the run."
        if len(hostile) < len(on_wires):
            caption = f"Brown: wires with a link on them. {caption}"
        return caption


class Trust(RunFigure):
    """The command centre's trust in each agent, and when it was suspended or taken to be faulty. Below each line: when
    adversaries changed what the agent sent, as measured on its wires, and when faults of the timeline acted on it.
    """

    def draw(self, context: FigureContext) -> Figure | None:
        return trust_over_time(context.run, context.frame)

    def alt(self, context: FigureContext) -> str:
        spells = [
            f"{each['agent']} from {each['from_s']:.1f} s to "
            + ("the end" if each["until_s"] is None else f"{each['until_s']:.1f} s")
            for each in suspensions(context.run)
        ]
        return f"Trust in each agent over time. Suspended: {'; '.join(spells) or 'no agent'}."


#: In the order in which they are drawn. The page has a place for each.
OURS: tuple[type[RunFigure], ...] = (Birdseye, Trust, Camera, Counts, Causes, Driving, Wiring)


def run_figures(context: FigureContext) -> dict[str, RenderedFigure]:
    """Our figures of one run by name, without those whose data are absent."""
    pictures = (rendered(kind(), context) for kind in OURS)
    return {each.name: each for each in pictures if each is not None}


def rendered(figure: RunFigure, context: FigureContext) -> RenderedFigure | None:
    """A figure as it goes into the page; None if there is nothing to draw."""
    drawn = figure.draw(context)
    if drawn is None:
        return None
    if not isinstance(drawn, MatplotlibFigure):
        raise TypeError(f"draw returned {type(drawn).__name__}, expected a Matplotlib figure or None")
    return render(figure.label(), drawn, figure.alt(context), figure.caption(context), vector=figure.vector)


def _the_picture(view: FrameView) -> str:
    """The picture that a view shows, in words."""
    variants = {"picture_received": "as the ego receives it", "picture_on_arrival": "when it reaches the ego"}
    variant = next((way for name, way in variants.items() if name in view.boxes), "")
    return f"the common picture {variant}".strip()


def counts_caption(runs: Sequence[RunFolder]) -> str:
    """How to read the counts of runs over time."""
    return _COUNTS_CAPTION + (_BANDS_CAPTION if any(run.faulted and run.timeline for run in runs) else "")


def tally(view: FrameView, estimator: str) -> str:
    """The numbers of boxes of an estimate in a frame, in words."""
    boxes = view.boxes[estimator]
    return (
        f"{len(boxes['truth missed'])} missed, {len(boxes['track false'])} false, {len(boxes['truth matched'])} matched"
    )
