"""A finished study as an object, and what opens a folder of a run or of a study."""

from __future__ import annotations

import html
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow

from mast_zenoh.api.runs import OpenedRun
from mast_zenoh.errors import ConfigurationError, RunFolderError
from mast_zenoh.run_folder import check_plain, read_json
from mast_zenoh.run_folder.tables import read_arrow

if TYPE_CHECKING:
    from mast_zenoh.show.compare import Comparison

#: Its folder has this file, which says how it ended.
FILE = "study.json"


class FinishedStudy:
    """A finished study and its tables.

    path:   its folder
    report: its HTML page
    runs:   the run of each configuration by label, if each was run once; {} for many trials
    """

    def __init__(self, path: str | Path, text: str = "") -> None:
        """text: its main results, as on the terminal; empty: table.md."""
        self.path = Path(path).resolve()
        self.report = self.path / "report.html"
        labels = read_json(self.path / FILE).get("runs")
        names = [each.name for each in self.path.iterdir()]  # whatever study.json says, nothing outside is opened
        labels = [label for label in labels if label in names] if isinstance(labels, list) else []
        self.runs = {label: OpenedRun(self.path / label) for label in labels}
        self._text = text

    def table(self) -> pyarrow.Table:
        """The estimates.

        For many trials: a row per configuration and series, with intervals (table.csv, docs/how-to-studies.md). If each
        configuration was run once: the table of `mast_zenoh.compare`.
        """
        if self.runs:
            return self.comparison.table
        from pyarrow import csv

        file = self._of_trials("table.csv")
        try:
            return csv.read_csv(file)
        except pyarrow.ArrowInvalid as error:
            raise RunFolderError(f"{file}: no table: {error}") from None

    @property
    def comparison(self) -> Comparison:
        """The runs compared with the first; only if each configuration was run once."""
        if not self.runs:
            raise ConfigurationError(f"{self.path}: a study with trials keeps no runs: expected one without `trials`")
        from mast_zenoh.show.compare import Comparison  # drawing libraries are slow to load

        baseline = ["baseline"] if "baseline" in self.runs else []
        labels = [*baseline, *(label for label in self.runs if label not in baseline)]
        return Comparison(tuple(self.runs[label] for label in labels))

    @property
    def results(self) -> pyarrow.Table:
        """A row per trial and metric (docs/how-to-studies.md)."""
        return read_arrow(self._of_trials("results.parquet"))

    @property
    def frames(self) -> pyarrow.Table:
        """A row per trial, frame, agent and estimator (docs/how-to-studies.md)."""
        return read_arrow(self._of_trials("frames.parquet"))

    def _of_trials(self, name: str) -> Path:
        if not (self.path / name).is_file():
            raise RunFolderError(f"{self.path / name}: missing: only a study with `trials` writes it")
        return check_plain(self.path / name)

    def __str__(self) -> str:
        """The main results, as on the terminal."""
        if self.runs:
            return str(self.comparison)
        return self._text or self._of_trials("table.md").read_text(encoding="utf-8")

    def __repr__(self) -> str:
        return f"<FinishedStudy {self.path.name}: .table(), .report; {self.path}>"

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre><p>Report: {html.escape(str(self.report))}</p>"


def open_folder(path: str | Path) -> Any:
    """Open a folder: that of a finished or running run is a `Run`, that of a study a `FinishedStudy`.

    Raises RunFolderError if there is neither.
    """
    return FinishedStudy(path) if (Path(path) / FILE).is_file() else OpenedRun(path)
