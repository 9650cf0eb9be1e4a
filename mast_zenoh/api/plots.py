"""The report's figures of a run, or of several, as Matplotlib figures that a notebook shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.launch.tables import read_table
from mast_zenoh.report.figures.causes import causes_over_time
from mast_zenoh.report.figures.charts import REPORT_COLUMNS, counts_over_time
from mast_zenoh.report.figures.diagram import draw_wiring
from mast_zenoh.report.figures.drawing import birdseye_figure, camera_figure, side_by_side_figure
from mast_zenoh.report.figures.driving import driving_over_time
from mast_zenoh.report.figures.style import Figure
from mast_zenoh.report.figures.view import FrameView, check_frame, choose_common_frame, choose_frame, frame_view
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.scores import ESTIMATES, score_table


class Run(Protocol):
    """A run as figures need it; `mast_zenoh.api.runs.Run` is one."""

    @property
    def path(self) -> Path:
        """The run folder."""

    def _folder(self) -> RunFolder:
        """Its content, as the report reads it."""


class Plots:
    """Figures of runs by label: of the first one, and where several are compared, of all.

    Each method returns a Matplotlib figure: a notebook shows it, `figure.savefig("name.png")` keeps it.
    """

    def __init__(self, runs: Mapping[str, RunFolder]) -> None:
        self._runs = dict(runs)
        self._first = next(iter(self._runs.values()))

    def over_time(
        self, metric: str | Sequence[str] = REPORT_COLUMNS, *others: Run, estimate: str = "picture"
    ) -> Figure:
        """A metric of the ego by time: bold over the last five frames, pale in single frames; attacks are shaded.

        metric:   a numeric column of `Run.metrics`, such as "fp", "fn", "rmse_m", or several, one below the other
        others:   further runs to draw
        estimate: that is drawn where there are several runs; of one run, all are
        """
        runs = {label: _with_all_columns(run) for label, run in (self._runs | labelled(others, self._runs)).items()}
        columns = (metric,) if isinstance(metric, str) else tuple(metric)
        for label, run in runs.items():
            known = [name for name, values in (run.counts or {}).items() if values.dtype.kind in "fiu"]
            for name in columns:
                if known and name not in known:
                    raise ConfigurationError(f"{label}: no metric {name!r}{nearest(name, set(known) - {'frame'})}")
        if estimate not in ESTIMATES:
            raise ConfigurationError(f"no estimate {estimate!r}{nearest(estimate, ESTIMATES)}")
        return self._drawn(
            counts_over_time(runs, None, estimate, columns), "metrics.parquet holds no scores of the ego"
        )

    def birdseye(self, frame: int | None = None) -> Figure:
        """The ego's surroundings from above in a frame: its own tracks, the picture, and both.

        frame: None: the one that the report shows
        """
        return birdseye_figure(self._view(frame))

    def camera(self, frame: int | None = None) -> Figure:
        """The same frame through the ego's camera: its own tracks above, both below."""
        return self._drawn(camera_figure(self._view(frame)), "the ego is not in the scene")

    def causes(self) -> Figure:
        """Missed and false objects of the picture by time, stacked by cause: of runs with links or faults."""
        figure = causes_over_time(self._first, None)
        return self._drawn(figure, "causes are drawn of runs with links or faults that left their objects")

    def driving(self) -> Figure:
        """Time to collision, wrong objects in the ego's corridor and braking by time."""
        return self._drawn(driving_over_time(self._first, None), "the run left no driving.parquet")

    def wiring(self) -> Figure:
        """The nodes and the data between them; intercepted wires are bold."""
        return self._drawn(draw_wiring(self._first), "the run left no wiring.json")

    def side_by_side(self, frame: int | None = None, *others: Run, estimate: str = "picture") -> Figure:
        """One estimate of several runs in the same frame from above, their scores below.

        frame: None: the one in which a run differs most from the first
        """
        runs = self._runs | labelled(others, self._runs)
        if frame is None:
            frame = choose_common_frame(list(runs.values()), self._first, estimate)
        views = {label: _view(run, frame) for label, run in runs.items()}
        for label, view in views.items():
            if estimate not in view.boxes:
                raise ConfigurationError(f"{label}: no boxes of {estimate!r}{nearest(estimate, view.boxes)}")
        table = score_table({label: run.metrics for label, run in runs.items()}, agent=self._first.ego or "ego")
        return side_by_side_figure(views, table, estimate)

    def _view(self, frame: int | None) -> FrameView:
        return _view(self._first, choose_frame(self._first) if frame is None else frame)

    def _drawn(self, figure: Figure | None, lack: str) -> Figure:
        if figure is None:
            reasons = " ".join(self._first.missing)
            raise RunFolderError(f"{self._first.path}: nothing to draw: {lack}{f'; {reasons}' if reasons else ''}")
        return figure

    def __repr__(self) -> str:
        drawn = ", ".join(name for name in vars(Plots) if not name.startswith("_"))
        return f"<plots of {', '.join(self._runs)}: {drawn}>"


def labelled(runs: Sequence[Run], taken: Mapping[str, RunFolder]) -> dict[str, RunFolder]:
    """Runs by a label that none of `taken` has: the scenario's name, else that of the folder, else with a number."""
    result: dict[str, RunFolder] = {}
    for run in runs:
        loaded = run._folder()
        names = [loaded.label, run.path.name, *(f"{loaded.label} ({number})" for number in range(2, 1000))]
        result[next(name for name in names if name not in {*taken, *result})] = loaded
    return result


def _with_all_columns(run: RunFolder) -> RunFolder:
    """The run with every column of metrics.parquet: the report itself needs a few."""
    return replace(run, counts=read_table(run.path / "metrics.parquet")) if run.counts is not None else run


def _view(run: RunFolder, frame: int | None) -> FrameView:
    view = None if frame is None else frame_view(run, check_frame(run, frame))
    if view is None:
        reasons = " ".join(run.missing) or "no frame is both scored and settled: name one"
        raise RunFolderError(f"{run.path}: no frame to draw: {reasons}")
    return view
