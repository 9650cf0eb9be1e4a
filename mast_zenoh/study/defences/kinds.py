"""What all kinds of studies of defences have: cells, an evaluation of each trial, and a collection of all trials.

A kind is a module of this package, with a subclass of DefenceCell, what differs between its configurations, and a
subclass of `Collection` of this name. It loads SciPy's statistics, tables and drawing libraries only when they are
needed: scenarios import its cells.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.study_results import Measured, size_of
from mast_zenoh.run_folder import write_bytes
from mast_zenoh.study.defences import intervals
from mast_zenoh.study.trial import Outcome, TrialKey

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from mast_zenoh.report.figures.drawing import RenderedFigure
    from mast_zenoh.report.tables.text_table import ResultTables
    from mast_zenoh.runs.run import Run


class DefenceCell:
    """One configuration of a study of defences; subclasses are frozen dataclasses.

    kind: name of its module in this package
    """

    __slots__ = ()
    kind: ClassVar[str]

    @property
    def label(self) -> str:
        """The label of its configuration."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class StudyFiles:
    """What a study of defences, or a search, wrote: tables and figures for the page, and names of files.

    on_page: whether the tables are on the page, too
    """

    tables: ResultTables
    figures: Mapping[str, RenderedFigure]
    names: Sequence[str]
    on_page: bool = True


class Collection(ABC):
    """Evaluates each trial of a study, collects all of them, and writes its tables and figures.

    name: of the files;  drawn: names of all figures that it may write
    recorded: whether the evaluation needs all messages of a run
    from_metrics: whether metrics.json has all that the table needs: trials need no run folder and no evaluation
    without_lies: the part `defence` of a trial in which nothing lies and nothing is faulty, which is then neither
                  recorded nor evaluated; None: every trial is evaluated
    """

    name: ClassVar[str]
    drawn: ClassVar[Sequence[str]] = ()
    recorded: ClassVar[bool] = False
    from_metrics: ClassVar[bool] = False
    without_lies: ClassVar[Mapping[str, Any] | None] = None

    def __init__(self, cells: Mapping[str, Any], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        """cells: by label of configuration;  scenes, seeds: planned for every cell."""
        self.size = size_of(len(seeds), len(scenes))
        self.scenes = len(scenes)
        #: records of the trials that are done, by cell, in the order in which they were added
        self.records: dict[Any, dict[TrialKey, Any]] = {cell: {} for cell in cells.values()}
        #: the trials planned for every cell, with their place in the order of the study
        self.order = {TrialKey(scene, seed): index for index, (scene, seed) in enumerate(product(scenes, seeds))}
        self._cells = dict(cells)

    @staticmethod
    @abstractmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        compromised: names of the agents with an adversary, whether it lied or not
        """

    def add(self, outcome: Outcome) -> None:
        """Add a finished trial."""
        cell = self._cells[outcome.trial.configuration]
        self.records[cell][outcome.trial.key] = self.record(cell, outcome)

    def mean(
        self, values: ArrayLike, bounds: tuple[float, float] = (-math.inf, math.inf), *, paired: bool = False
    ) -> Measured:
        """The mean over the trials planned for a cell (n,), in the order of the study; see `intervals.mean`."""
        return intervals.mean(values, bounds, scenes=self.scenes, paired=paired)

    def values(self, cell: Any, name: str) -> Floats:
        """(trials,) a number of each trial planned for a cell, in the order of the study; NaN: it has none.

        Of kinds whose records give numbers by name (`record[name]`).
        """
        records = self.records.get(cell, {})
        return np.array([records[key][name] if key in records else math.nan for key in self.order])

    @abstractmethod
    def record(self, cell: Any, outcome: Outcome) -> Any:
        """What the table needs of one trial."""

    @abstractmethod
    def table(self) -> Any:
        """The table of all trials."""

    @abstractmethod
    def tables(self, table: Any) -> ResultTables:
        """The table as text."""

    def more_tables(self, table: Any) -> Mapping[str, ResultTables]:
        """Other tables by file name, which the terminal does not show."""
        return {}

    def figures(self, table: Any) -> Mapping[str, RenderedFigure]:
        """The figures of a table."""
        return {}

    def write(self, folder: Path) -> StudyFiles:
        """Write tables and figures into the study's folder, and remove figures that it does not have any more."""
        table = self.table()
        tables, figures = self.tables(table), self.figures(table)
        texts = tables.texts(self.name)
        for name, more in self.more_tables(table).items():
            texts |= more.texts(name)
        for name, text in texts.items():
            write_bytes(folder / name, text.encode())
        for name in {*self.drawn} - {*figures}:
            for suffix in ("png", "pdf"):
                (folder / f"{name}.{suffix}").unlink(missing_ok=True)
        for figure in figures.values():
            figure.save(folder)
        names = [*texts, *(name for figure in figures.values() for name in figure.names)]
        return StudyFiles(tables, figures, names)


def collection_of(kind: str) -> type[Collection]:
    """The collection of a kind of study."""
    collection: type[Collection] = import_module(f"{__package__}.{kind}").Collection
    return collection
