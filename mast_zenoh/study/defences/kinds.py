"""What all kinds of studies have: factors of configurations, measures of each trial, tables and figures of all trials.

A kind is a subclass of `Kind`, in a module of this package or in the file of a study, which names it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.config import loading
from mast_zenoh.metrics.study_results import MIN_SEEDS, NAN, Statistic, size_of
from mast_zenoh.run_folder import write_bytes
from mast_zenoh.show.tables.text_table import FEW_TRIALS, ResultTables
from mast_zenoh.study.defences import intervals
from mast_zenoh.study.trial import TrialKey, TrialOutcome

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.figures.drawing import RenderedFigure


class Factors(dict[str, Any]):
    """What configurations of a study differ in, by name: attack, agents, …; texts, numbers, None. It can be a key."""

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def but(self, **changes: Any) -> Self:
        """The same with other values of some."""
        return type(self)(self | changes)


@dataclass(frozen=True, slots=True)
class StudyFiles:
    """What a kind of study, or a search, wrote: tables and figures for the page, and names of files.

    on_page: whether the tables are on the page, too
    """

    tables: ResultTables
    figures: Mapping[str, RenderedFigure]
    names: Sequence[str]
    on_page: bool = True


class Kind(ABC):
    """Takes measures of each trial of a study, and writes tables and figures of all of them.

    name: of the files;  drawn: names of all figures that it may write
    recorded: whether `evaluate` needs all messages of a run
    without_lies: the part `defence` of a trial in which nothing lies and nothing is faulty, which is then neither
                  recorded nor evaluated; None: every trial is evaluated
    """

    name: ClassVar[str]
    drawn: ClassVar[Sequence[str]] = ()
    recorded: ClassVar[bool] = False
    without_lies: ClassVar[Mapping[str, Any] | None] = None

    def __init__(self, factors: Mapping[str, Factors], scenes: Sequence[str], seeds: Sequence[int]) -> None:
        """factors: by label of configuration;  scenes, seeds: planned for every configuration."""
        self.size = size_of(len(seeds), len(scenes))
        self.scenes = list(scenes)
        #: measures of the trials that are done, by factors, in the order in which they were added
        self.trials: dict[Factors, dict[TrialKey, dict[str, Any]]] = {each: {} for each in factors.values()}
        #: the trials planned for every configuration, with their place in the order of the study
        self.order = {TrialKey(scene, seed): index for index, (scene, seed) in enumerate(product(scenes, seeds))}
        self._factors = dict(factors)

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics, from its run folder; without this method, trials need none.

        compromised: names of the agents with an adversary, whether it lied or not
        """
        raise NotImplementedError

    @abstractmethod
    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """What the tables need of one trial, by name; numbers can be NaN."""

    @abstractmethod
    def table(self) -> Any:
        """The rows of all trials, from which tables and figures are made."""

    @abstractmethod
    def tables(self, table: Any) -> ResultTables:
        """The rows as text."""

    def more_tables(self, table: Any) -> Mapping[str, ResultTables]:
        """Other tables by file name, which the terminal does not show."""
        return {}

    def figures(self, table: Any) -> Mapping[str, RenderedFigure]:
        """The figures of the rows."""
        return {}

    def add(self, outcome: TrialOutcome) -> Mapping[str, Any]:
        """Add a finished trial; returns its measures."""
        factors = self._factors[outcome.trial.configuration]
        measures = self.trials[factors][outcome.trial.key] = self.measures(factors, outcome)
        return measures

    def values(self, factors: Factors, name: str) -> Floats:
        """(trials,) a number of each trial planned for a configuration, in the order of the study; NaN: it has none."""
        done = self.trials.get(factors, {})
        return np.array([done[key].get(name, NAN) if key in done else NAN for key in self.order], np.float64)

    def mean(
        self, values: ArrayLike, bounds: tuple[float, float] = (-math.inf, math.inf), *, paired: bool = False
    ) -> Statistic:
        """The mean over the trials planned for a configuration (n,), in the study's order; see `intervals.mean`."""
        return intervals.mean(values, bounds, scenes=len(self.scenes), paired=paired)

    @property
    def own(self) -> list[str]:
        """The user's metrics that any trial has, `own NAME`; see `numbers.own_metrics`."""
        names = dict.fromkeys(name for done in self.trials.values() for each in done.values() for name in each)
        return [name for name in names if name.startswith("own ")]

    def several(self, name: str) -> list[Any]:
        """The values of a factor, in the order of the study."""
        return list(dict.fromkeys(factors.get(name) for factors in self.trials))

    def write(self, folder: Path) -> StudyFiles:
        """Write tables and figures into the study's folder, and remove figures that it does not have any more."""
        table = self.table()
        tables, figures = self.tables(table), self.figures(table)
        texts = tables.texts(self.name)
        for name, more in self.more_tables(table).items():
            texts |= more.texts(name)
        for name in {*self.drawn} - {*figures}:
            for suffix in ("png", "pdf"):
                (folder / f"{name}.{suffix}").unlink(missing_ok=True)
        return StudyFiles(tables, figures, write_files(folder, texts, figures))


def few_trials(numbers: Iterable[Statistic]) -> str:
    """The note below tables whose numbers have too few trials for intervals; "": none has."""
    few = any(each.known and not each.interval and 0 < each.trials < MIN_SEEDS for each in numbers)
    return FEW_TRIALS if few else ""


def write_files(folder: Path, texts: Mapping[str, str], figures: Mapping[str, RenderedFigure]) -> list[str]:
    """Write texts, by name of their files, and figures into the folder of a study; returns the names of all files."""
    for name, text in texts.items():
        write_bytes(folder / name, text.encode())
    for figure in figures.values():
        figure.save(folder)
    return [*texts, *(name for figure in figures.values() for name in figure.names)]


def name_of_kind(kind: type[Kind]) -> str:
    """By which `kind_of` finds a kind, in other processes too: MODULE:CLASS, or FILE.py:CLASS of a user's file."""
    file = loading.file_of_class(kind)
    own = kind.__module__.startswith("mast_zenoh.") or file is None
    return f"{kind.__module__ if own else file}:{kind.__name__}"


def kind_of(name: str) -> type[Kind]:
    """The kind of study of a name."""
    place, _, cls = name.rpartition(":")
    module = loading.module(Path(place)) if place.endswith(".py") else import_module(place)
    kind: type[Kind] = getattr(module, cls)
    return kind
