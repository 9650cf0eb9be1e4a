"""Compares runs: their scores side by side, and the differences in words."""

from __future__ import annotations

import html
import io

import pyarrow
from rich.console import Console, RenderableType

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.run_folder import reading
from mast_zenoh.runs.run import Run
from mast_zenoh.show import comparison
from mast_zenoh.show.comparison import Reference
from mast_zenoh.show.figures.plots import Plots, labelled
from mast_zenoh.show.findings import of_compared
from mast_zenoh.show.tables.scores import OVER_ALONE, score_table


class Comparison:
    """Runs of the same scene and seed, compared with the first; prints as a table."""

    def __init__(self, runs: tuple[Run, ...]) -> None:
        if len(runs) < 2:
            raise ConfigurationError(f"compare: found {len(runs)} run, expected two or more")
        for run in runs:
            if not isinstance(run, Run):
                raise ConfigurationError(f"compare: found {run!r}, expected a run; mast.open opens a folder as one")
        self._folders = labelled(runs, {})
        self._reference, *others = self._folders
        first = self._folders[self._reference]
        with reading(first.path):
            for label in others:
                comparison.reference(self._folders[label], first.path)
            self._scores = score_table(self._folders, self._reference)

    @property
    def table(self) -> pyarrow.Table:
        """A row per metric, run and estimate of the ego: mean, std (over frames), change.

        The change is over the first run.
        Counts are objects per frame, lengths (`…_m`) are in m; id_switches are of the whole run.
        """
        scores = [each for each in self._scores.rows if each.estimate != OVER_ALONE]
        rows = [{"metric": each.measure.label} | each._asdict() for each in scores]
        text, number = pyarrow.string(), pyarrow.float64()
        types = {"metric": text, "run": text, "estimate": text, "mean": number, "std": number, "change": number}
        return pyarrow.Table.from_pylist(rows, schema=pyarrow.schema(types))

    @property
    def headline(self) -> str:
        """What the page of compared runs says of each, in a line: such as the largest difference from the first."""
        reference = Reference(self._folders[self._reference], self._reference)
        return "\n".join(of_compared(self._folders, reference)[1])

    @property
    def plot(self) -> Plots:
        """Figures of all the runs: `over_time("fp")`, `side_by_side(frame=64)`."""
        return Plots(self._folders)

    def markdown(self) -> str:
        """The table as Markdown, with all metrics."""
        return f"{self._scores.text().markdown()}\n"

    def __str__(self) -> str:
        return f"{as_text(self._scores.as_rich())}\n{self.headline}"

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(self._folders)}; print it, or see .table, .headline, .plot>"

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


def as_text(tables: RenderableType) -> str:
    """Terminal tables as plain text."""
    page = io.StringIO()
    Console(file=page, width=100, color_system=None).print(tables)
    return "\n".join(line.rstrip() for line in page.getvalue().splitlines())


def compare(*runs: Run) -> Comparison:
    """Compare runs with the first one, such as a baseline.

    Raises NotComparable unless all played the same scene, seed and frames, and were scored in the same way.
    """
    return Comparison(runs)
