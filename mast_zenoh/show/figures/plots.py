"""The report's figures of one or several runs, as Matplotlib figures.

Charts of the command centre's trust in each agent over time, of a run and of single trials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.metrics.trust import AgentTrustSeries, Spans, TrustPanel
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.runs.events import trust_in_agents
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.diagram import draw_wiring
from mast_zenoh.show.figures.drawing import RenderedFigure, birdseye_figure, camera_figure, render, side_by_side_figure
from mast_zenoh.show.figures.over_time import (
    REPORT_COLUMNS,
    causes_over_time,
    counts_over_time,
    driving_over_time,
    legend_above,
)
from mast_zenoh.show.figures.style import Figure, light_axes, plain
from mast_zenoh.show.figures.timeaxis import HATCH, padded
from mast_zenoh.show.figures.view import check_frame, choose_common_frame, choose_frame, frame_view
from mast_zenoh.show.palette import ADVERSARY_ON_LIGHT, FAULT_ON_LIGHT, INK, STATES_ON_LIGHT
from mast_zenoh.show.tables.scores import score_table


class Plots:
    """Figures of runs by label: of the first one or, in comparisons, of all.

    Each method returns a Matplotlib figure: a notebook displays it, `figure.savefig("name.png")` saves it.
    """

    def __init__(self, runs: Mapping[str, Run]) -> None:
        self._runs = dict(runs)
        self._first = next(iter(self._runs.values()))

    def over_time(
        self, metric: str | Sequence[str] = REPORT_COLUMNS, *others: Run, estimate: str = "picture"
    ) -> Figure:
        """A metric of the ego over time, with attacks shaded.

        Bold lines are means over the last five frames, pale lines the values of single frames.

        metric:   a numeric column of `Run.metrics`, such as "fp", "fn", "rmse_m", or several for stacked charts
        others:   other runs to draw
        estimate: the one to draw for several runs; for one run, all are drawn
        """
        runs = {label: _with_all_columns(run) for label, run in (self._runs | labelled(others, self._runs)).items()}
        columns = (metric,) if isinstance(metric, str) else tuple(metric)
        for label, run in runs.items():
            known = [name for name, values in (run.files.counts or {}).items() if values.dtype.kind in "fiu"]
            for name in columns:
                if known and name not in known:
                    raise ConfigurationError(f"{label}: no metric {name!r}{nearest(name, set(known) - {'frame'})}")
        if estimate not in ESTIMATES:
            raise ConfigurationError(f"no estimate {estimate!r}{nearest(estimate, ESTIMATES)}")
        return self._require(
            counts_over_time(runs, None, estimate, columns), "metrics.parquet holds no scores of the ego"
        )

    def birdseye(self, frame: int | None = None) -> Figure:
        """Bird's-eye views of one frame: the ego's own tracks, the picture, and both.

        frame: by default the frame that the report shows
        """
        return birdseye_figure(self._view(frame))

    def camera(self, frame: int | None = None) -> Figure:
        """The ego's camera view: its own tracks above, tracks and picture below."""
        return self._require(camera_figure(self._view(frame)), "the ego is not in the scene")

    def causes(self) -> Figure:
        """Missed and false objects by cause over time, for runs with links or faults."""
        figure = causes_over_time(self._first, None)
        return self._require(figure, "causes are known only for runs with links or faults, and with objects.parquet")

    def driving(self) -> Figure:
        """Time to collision, wrong objects in the ego's corridor and braking by time."""
        return self._require(driving_over_time(self._first, None), "there is no driving.parquet")

    def wiring(self) -> Figure:
        """The nodes and the data between them; intercepted wires are bold."""
        return self._require(draw_wiring(self._first), "there is no wiring.json")

    def side_by_side(self, frame: int | None = None, *others: Run, estimate: str = "picture") -> Figure:
        """Bird's-eye views of one estimate of several runs, with scores below.

        frame: by default the frame in which a run differs most from the first
        """
        runs = self._runs | labelled(others, self._runs)
        if frame is None:
            frame = choose_common_frame(list(runs.values()), self._first, estimate)
        views = {label: _view(run, frame) for label, run in runs.items()}
        for label, view in views.items():
            if estimate not in view.boxes:
                raise ConfigurationError(f"{label}: no boxes of {estimate!r}{nearest(estimate, view.boxes)}")
        return side_by_side_figure(views, score_table(runs), estimate)

    def _view(self, frame: int | None) -> Frame:
        return _view(self._first, choose_frame(self._first) if frame is None else frame)

    def _require(self, figure: Figure | None, reason: str) -> Figure:
        if figure is None:
            reasons = " ".join(self._first.files.missing)
            raise RunFolderError(f"{self._first.path}: nothing to draw: {reason}{f'; {reasons}' if reasons else ''}")
        return figure

    def __repr__(self) -> str:
        drawn = ", ".join(name for name in vars(Plots) if not name.startswith("_"))
        return f"<plots of {', '.join(self._runs)}: {drawn}>"


def labelled(runs: Sequence[Run], taken: Mapping[str, Run]) -> dict[str, Run]:
    """Runs by unique label, none of which is in `taken`.

    A label is the scenario's name, else the folder's, else the name with a number.
    """
    result: dict[str, Run] = {}
    for run in runs:
        loaded = Run(run.path)
        names = [loaded.name, run.path.name, *(f"{loaded.name} ({number})" for number in range(2, 1000))]
        result[next(name for name in names if name not in {*taken, *result})] = loaded
    return result


def _with_all_columns(run: Run) -> Run:
    """The run with every column of metrics.parquet, of which the report needs few."""
    return run.with_(counts=read_table(run.path / "metrics.parquet")) if run.files.counts is not None else run


def _view(run: Run, frame: int | None) -> Frame:
    view = None if frame is None else frame_view(run, check_frame(run, frame))
    if view is None:
        reasons = " ".join(run.files.missing) or "no frame is both scored and settled: set `frame`"
        raise RunFolderError(f"{run.path}: no frame to draw: {reasons}")
    return view


class Scale(NamedTuple):
    """The axis of trust: its limits, its ticks with their labels, and the name of the quantity."""

    low: float
    high: float
    ticks: Sequence[tuple[float, str]]
    label: str


MEAN = Scale(0.0, 1.0, ((0.0, "0"), (0.5, ""), (1.0, "1")), "trust, 0 to 1")
#: Greater log-odds are drawn at the limits.
LOG_ODDS = Scale(-10.0, 10.0, ((-10.0, "\u221210"), (0.0, "0"), (10.0, "10")), "log-odds that the agent is honest")

#: Inches: width of the figure, of its left margin with the agents' names; heights of the legend and the time axis.
_WIDTH, _LEFT, _RIGHT, _HEAD, _FOOT = 11.5, 1.35, 0.15, 0.46, 0.55
#: Inches, height of one agent's row: least, greatest, the sum of all from which it shrinks; least with names of faults.
_ROW = (0.42, 0.86, 5.5)
_NAMED = 0.7
#: Below the trust, from 0 to 1: lower edges and height of the bands of lies and of faults.
_LIES, _FAULTS, _BAND = -0.24, -0.46, 0.18


def trust_over_time(run: Run, frame: int | None) -> Figure | None:
    """Mean trust in each agent by time; None: the run's command centre judges nobody.

    Background: when an agent was taken to be faulty, suspended or undecided. Bands below: when it lied, and when it was
    faulty. frame: marked by a line, if given
    """
    agents, end = trust_in_agents(run, list(STATES_ON_LIGHT))
    if not agents:
        return None
    low = min(float(agent.time_s.min()) for agent in agents)
    row = float(np.clip(_ROW[2] / len(agents), *_ROW[:2]))
    height = _HEAD + row * len(agents) + _FOOT
    figure = Figure(figsize=(_WIDTH, height), facecolor="white")
    for index, agent in enumerate(agents):
        axes = figure.place(_LEFT, _HEAD + (index + 0.12) * row, _WIDTH - _LEFT - _RIGHT, 0.88 * row)
        draw_agent(axes, agent, end, named=row >= _NAMED)
        axes.set_xlim(*padded(low, end))
        axes.tick_params(labelbottom=index == len(agents) - 1)
        if frame is not None:
            axes.axvline(float(run.times(np.array([frame]))[0]), color=INK, linewidth=0.9)
        if index == len(agents) - 1:
            axes.set_xlabel("time (s)", fontsize=10, color=INK)
    handles = legend(agents)
    if frame is not None:
        handles.append(Line2D([], [], color=INK, linewidth=0.9, label="frame shown"))
    legend_above(figure, {str(each.get_label()): each for each in handles}, len(handles), columnspacing=1.5)
    return figure


def draw_agent(axes: Axes, agent: AgentTrustSeries, end: float, scale: Scale = MEAN, *, named: bool) -> None:
    """Draw one agent's row.

    end: s, of the run;  named: whether there is room for the names of faults
    """
    light_axes(axes)
    for state, colour in STATES_ON_LIGHT.items():
        for start, stop in agent.states.get(state, ()):  # stored traces of older versions lack some
            axes.add_patch(Rectangle((start, 0.0), stop - start, 1.0, facecolor=colour, alpha=0.45, linewidth=0))
    _bands(axes, agent.lies, _LIES, ADVERSARY_ON_LIGHT)
    _bands(axes, [(start, stop) for _, start, stop in agent.faults], _FAULTS, FAULT_ON_LIGHT, hatched=True)
    if named:
        for kind, start, stop in agent.faults:
            after = stop < 0.8 * end
            place, align = (stop + 0.006 * end, "left") if after else (start - 0.006 * end, "right")
            middle = _FAULTS + 0.5 * _BAND
            axes.text(place, middle, plain(kind), ha=align, va="center", fontsize=8.5, color=FAULT_ON_LIGHT)
    value = (np.clip(agent.value, scale.low, scale.high) - scale.low) / (scale.high - scale.low)
    axes.plot(agent.time_s, value, color=INK, linewidth=1.6, drawstyle="steps-post")
    axes.set_ylim(_FAULTS - 0.06, 1.06)
    places = [(tick - scale.low) / (scale.high - scale.low) for tick, _ in scale.ticks]
    axes.set_yticks(places, [label for _, label in scale.ticks], fontsize=9)
    axes.set_ylabel(plain(agent.agent), rotation=0, ha="right", va="center", fontsize=10.5, color=INK, labelpad=10)


def _bands(axes: Axes, spans: Spans, lower: float, colour: str, *, hatched: bool = False) -> None:
    for start, stop in spans:
        band = Rectangle((start, lower), stop - start, _BAND, linewidth=0.6)
        band.set(facecolor=(colour, 0.25 if hatched else 0.9), edgecolor=colour, hatch=HATCH if hatched else None)
        axes.add_patch(band)


def legend(agents: Sequence[AgentTrustSeries], scale: Scale = MEAN) -> list[Line2D | Patch]:
    """Legend entries for what the rows of these agents show."""
    handles: list[Line2D | Patch] = [Line2D([], [], color=INK, linewidth=1.6, label=scale.label)]
    for state, colour in STATES_ON_LIGHT.items():
        if any(agent.states.get(state) for agent in agents):
            label = "taken to be faulty" if state == "faulty" else state
            handles.append(Patch(facecolor=colour, alpha=0.45, label=label))
    if any(agent.lies for agent in agents):
        handles.append(Patch(facecolor=(ADVERSARY_ON_LIGHT, 0.9), edgecolor=ADVERSARY_ON_LIGHT, label="lies"))
    if any(agent.faults for agent in agents):
        fault = Patch(facecolor=(FAULT_ON_LIGHT, 0.25), edgecolor=FAULT_ON_LIGHT, hatch=HATCH, label="is faulty")
        handles.append(fault)
    return handles


#: Number of panels in a line.
_COLUMNS = 3
#: Inches: width of a panel, of its margin with the agents' names and of the gap to the next one.
_PANEL, _PANEL_LEFT, _GAP = 3.8, 0.92, 0.12
#: Inches: heights of an agent's row, of a panel's title, of its time axis, and of the legend.
_PANEL_ROW, _TITLE, _PANEL_FOOT, _PANEL_HEAD = 0.46, 0.3, 0.5, 0.42


def trust_figure(panels: Sequence[TrustPanel], unshown: int) -> RenderedFigure:
    """A panel per trial, a row per agent.

    unshown: number of pairs of a defence and an adversary without a panel
    """
    columns = min(_COLUMNS, len(panels))
    lines = [panels[start : start + columns] for start in range(0, len(panels), columns)]
    heights = [_TITLE + _PANEL_ROW * max(len(panel.agents) for panel in line) + _PANEL_FOOT for line in lines]
    width, height = max(columns * _PANEL, 2 * _PANEL), _PANEL_HEAD + sum(heights)
    figure = Figure(figsize=(width, height), facecolor="white")
    for number, line in enumerate(lines):
        top = _PANEL_HEAD + sum(heights[:number])
        for column, panel in enumerate(line):
            _draw_panel(figure, panel, column * _PANEL, top)
    every = [agent for panel in panels for agent in panel.agents]
    handles = legend(every, LOG_ODDS)
    figure.legend(handles=handles, loc="upper left", ncols=len(handles), frameon=False, fontsize=9.5, columnspacing=1.3)
    caption = (
        f"The first trial of each defence that suspends an agent or leaves one undecided, under each adversary: "
        f"{LOG_ODDS.label}, drawn at the limits beyond 10. Background: the state that the command centre gave to the "
        "agent. Bands: what it did."
    )
    if unshown:
        caption += f" {unshown} more pairs are not shown."
    titles = "; ".join(panel.title for panel in panels)
    alt = f"Trust in agents over time in single trials: {titles}."
    return render("trust_over_time", figure, alt, caption, printed=True)


def _draw_panel(figure: Figure, panel: TrustPanel, left: float, top: float) -> None:
    """Draw a panel, placed in inches from the upper left corner."""
    title = panel.title + (f" (and {panel.left_out} more agents)" if panel.left_out else "")
    figure.write(left + 0.12, top + 0.5 * _TITLE, title, fontsize=9.5, color=INK, va="center")
    for index, agent in enumerate(panel.agents):
        below = top + _TITLE + (index + 0.14) * _PANEL_ROW
        axes = figure.place(left + _PANEL_LEFT, below, _PANEL - _PANEL_LEFT - _GAP, 0.86 * _PANEL_ROW)
        draw_agent(axes, agent, panel.end_s, LOG_ODDS, named=False)
        axes.set_xlim(*padded(0.0, panel.end_s))
        axes.tick_params(labelsize=8)
        axes.tick_params(axis="y", labelsize=7, length=2)
        axes.yaxis.label.set(fontsize=8.5)
        axes.yaxis.labelpad = 4
        last = index == len(panel.agents) - 1
        axes.tick_params(labelbottom=last)
        if last:
            axes.set_xlabel("time (s)", fontsize=8.5, color=INK, labelpad=1)
