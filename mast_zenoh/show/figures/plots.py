"""The report's figures of one or several runs, as Matplotlib figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mast_zenoh.errors import ConfigurationError, RunFolderError, nearest
from mast_zenoh.metrics.estimates import ESTIMATES
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.runs.frame import Frame
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.diagram import draw_wiring
from mast_zenoh.show.figures.drawing import birdseye_figure, camera_figure, side_by_side_figure
from mast_zenoh.show.figures.over_time import REPORT_COLUMNS, causes_over_time, counts_over_time, driving_over_time
from mast_zenoh.show.figures.style import Figure
from mast_zenoh.show.figures.view import check_frame, choose_common_frame, choose_frame, frame_view
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
