"""What a study of defences measures over all of its trials, and the files that it writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from mast_zenoh.report.figures.drawing import RenderedFigure
from mast_zenoh.study.defences.breakdown import BreakdownCollection
from mast_zenoh.study.defences.cells import Cell
from mast_zenoh.study.defences.drift import DriftCollection, size_of
from mast_zenoh.study.defences.limits import BreakdownCell, DriftCell
from mast_zenoh.study.trial import Outcome


@dataclass(frozen=True, slots=True)
class Written:
    """What a measurement wrote: figures for the page, names of all files, and the tables for the terminal."""

    figures: dict[str, RenderedFigure]
    files: list[str]
    as_rich: Callable[[], Any]


class Measurement(Protocol):
    """Collects the trials of a study, and writes its tables and figures."""

    def add(self, outcome: Outcome) -> None:
        """Add a finished trial."""

    def write(self, folder: Path) -> Written:
        """Write the files into the study's folder."""


def measurement(cells: Mapping[str, Any], scenes: Sequence[str], seeds: Sequence[int]) -> Measurement | None:
    """The measurement that the cells of a study ask for; None without cells.

    cells: by label of configuration, all of one class;  scenes, seeds: planned for every cell
    """
    for kind, cls in ((Cell, MatrixMeasurement), (DriftCell, DriftMeasurement), (BreakdownCell, BreakdownMeasurement)):
        if cells and all(isinstance(cell, kind) for cell in cells.values()):
            made: Measurement = cls(cells, scenes, seeds)
            return made
    return None


class MatrixMeasurement:
    """Every defence against every adversary."""

    def __init__(self, cells: Mapping[str, Cell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        from mast_zenoh.study.defences.estimates import Collection

        self._collection = Collection(cells, scenes, seeds)

    def add(self, outcome: Outcome) -> None:
        trial = outcome.trial
        self._collection.add(trial.configuration, trial.scene, trial.seed, outcome.metrics)

    def write(self, folder: Path) -> Written:
        from mast_zenoh.report.tables import defences as tables
        from mast_zenoh.study.defences import outputs

        matrix = self._collection.matrix()
        figures, files = outputs.write(folder, matrix)
        return Written(figures, files, lambda: tables.as_rich(matrix))


class DriftMeasurement:
    """How long displaced objects stay unnoticed."""

    def __init__(self, cells: Mapping[str, DriftCell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        self._collection = DriftCollection(cells, size_of(len(scenes), len(seeds)))

    def add(self, outcome: Outcome) -> None:
        self._collection.add(outcome.trial.configuration, outcome.metrics["defence"])

    def write(self, folder: Path) -> Written:
        from mast_zenoh.report.tables import drift as tables

        table = self._collection.table()
        files = _write_texts(folder, {"drift.md": tables.as_markdown(table), "drift.csv": tables.as_csv(table)})
        return Written({}, files, lambda: tables.as_rich(table))


class BreakdownMeasurement:
    """Where a defence breaks."""

    def __init__(self, cells: Mapping[str, BreakdownCell], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        self._collection = BreakdownCollection(cells, size_of(len(scenes), len(seeds)))

    def add(self, outcome: Outcome) -> None:
        trial = outcome.trial
        self._collection.add(trial.configuration, (trial.scene, trial.seed), outcome.metrics, outcome.per_frame)

    def write(self, folder: Path) -> Written:
        from mast_zenoh.report.figures.breakdown import figure_of_breakdown
        from mast_zenoh.report.tables import breakdown as tables

        table = self._collection.table()
        files = _write_texts(folder, {"breakdown.md": tables.as_markdown(table), "breakdown.csv": tables.as_csv(table)})
        figure = figure_of_breakdown(table)
        figure.save(folder)
        return Written({figure.name: figure}, [*files, f"{figure.name}.png"], lambda: tables.as_rich(table))


def _write_texts(folder: Path, texts: Mapping[str, str]) -> list[str]:
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return list(texts)
