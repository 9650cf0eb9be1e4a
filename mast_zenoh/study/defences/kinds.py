"""What all kinds of studies have: factors of configurations, measures of each trial, tables and figures of all trials.

A kind is a subclass of `Kind`, in a module of this package or in the file of a study, which names it.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import product
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.config import loading
from mast_zenoh.errors import ConfigurationError, MastError, is_from_outside, nearest, place_of
from mast_zenoh.metrics.study_results import MIN_SEEDS, NAN, Statistic, size_of
from mast_zenoh.run_folder import write_bytes
from mast_zenoh.show.number_text import FEW_TRIALS
from mast_zenoh.show.tables.text_table import ResultTables
from mast_zenoh.study import statistics
from mast_zenoh.study.trial import TrialKey, TrialOutcome
from mast_zenoh.wiring.plain_shapes import is_name

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from mast_zenoh.runs.run import Run
    from mast_zenoh.show.figures.drawing import RenderedFigure


Expected = TypeVar("Expected")
#: In the text of a TypeError: a function was called with arguments that it does not have.
_WRONG_CALL = re.compile(
    r"unexpected keyword argument|required (positional|keyword-only) argument|positional arguments? but"
)


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

    tables:   None: they are left out
    on_page:  whether the tables are on the page, too
    left_out: why other results are not there
    """

    tables: ResultTables | None
    figures: Mapping[str, RenderedFigure]
    names: Sequence[str]
    on_page: bool = True
    left_out: Sequence[str] = ()


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
        #: why results cannot be made, with the number of trials or parts that fail so
        self._problems: Counter[str] = Counter()
        #: those of them that are wrong arguments
        self._wrong: list[str] = []

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
        """Add a finished trial; returns its measures, {} if they fail."""
        factors = self._factors[outcome.trial.configuration]
        with self._attempted("measures"):
            self.trials[factors][outcome.trial.key] = _named(self.measures(factors, outcome))
        return self.trials[factors].get(outcome.trial.key, {})

    def values(self, factors: Factors, name: str) -> Floats:
        """(trials,) a number of each trial planned for a configuration, in the order of the study; NaN: it has none.

        Raises LookupError for a name that no trial of the study has, and ConfigurationError for what is no number.
        """
        done = self.trials.get(factors, {})
        if not any(name in each for each in done.values()):
            known = {each for trials in self.trials.values() for measured in trials.values() for each in measured}
            if known and name not in known:
                raise LookupError(f"no trial has a measure {name!r}{nearest(name, known)}")
        found = [done[key].get(name, NAN) if key in done else NAN for key in self.order]
        for each in found:
            if not (each is None or isinstance(each, (Real, np.bool_))):
                raise ConfigurationError(f"measure {name!r}: found {each!r:.60} in a trial, expected a number")
        return np.array(found, np.float64)

    def mean(
        self, values: ArrayLike, bounds: tuple[float, float] = (-math.inf, math.inf), *, paired: bool = False
    ) -> Statistic:
        """The mean over the trials planned for a configuration (n,), in the study's order; see `statistics.mean`."""
        return statistics.mean(values, bounds, scenes=len(self.scenes), paired=paired)

    @property
    def own(self) -> list[str]:
        """The user's metrics that any trial has, `own NAME`; see `numbers.own_metrics`."""
        names = dict.fromkeys(name for done in self.trials.values() for each in done.values() for name in each)
        return [name for name in names if name.startswith("own ")]

    def several(self, name: str) -> list[Any]:
        """The values of a factor, in the order of the study."""
        return list(dict.fromkeys(factors.get(name) for factors in self.trials))

    def write(self, folder: Path) -> StudyFiles:
        """Write tables and figures into the study's folder, and remove figures that it does not have any more.

        Those that fail are left out.
        """
        tables, texts, figures = self._results()
        for name in {*self.drawn} - {*figures}:
            for suffix in ("png", "pdf"):
                (folder / f"{name}.{suffix}").unlink(missing_ok=True)
        left_out = [f"{each} (trials: {count})" if count > 1 else each for each, count in self._problems.items()]
        return StudyFiles(tables, figures, write_files(folder, texts, figures), left_out=left_out)

    def _results(self) -> tuple[ResultTables | None, dict[str, str], dict[str, RenderedFigure]]:
        """The tables, the contents of all files of tables, and the figures, without those that fail."""
        from mast_zenoh.show.figures.drawing import RenderedFigure  # drawing libraries are slow to load

        tables: ResultTables | None = None
        texts: dict[str, str] = {}
        figures: dict[str, RenderedFigure] = {}
        with self._attempted("table"):
            table = self.table()
            with self._attempted("tables"):
                made = _expected(self.tables(table), ResultTables, "ResultTables(...)")
                texts, tables = made.texts(_file_name(self.name)), made
            with self._attempted("more_tables"):
                for name, more in self.more_tables(table).items():
                    texts |= _expected(more, ResultTables, "ResultTables(...)").texts(_file_name(name))
            with self._attempted("figures"):
                for name, figure in _expected(self.figures(table), dict, "a dict").items():
                    drawn = _expected(figure, RenderedFigure, "what render(...) returns")
                    _file_name(drawn.name)
                    figures[name] = drawn
        return tables, texts, figures

    @contextmanager
    def _attempted(self, part: str) -> Iterator[None]:
        """Note the error of a part, a method of the kind, with its file and line."""
        try:
            yield
        except (Exception, SystemExit) as error:
            if is_from_outside(error):
                raise
            classes = [cls for cls in type(self).__mro__ if issubclass(cls, Kind) and cls is not Kind]
            place = place_of(error, {cls.__module__ for cls in classes})
            code = getattr(type(self), part).__code__
            text = str(error) if isinstance(error, MastError) else f"{type(error).__name__}: {error}"
            problem = f"{place or f'{code.co_filename}:{code.co_firstlineno}'}: {part}: {text}"
            self._problems[problem] += 1
            if isinstance(error, ConfigurationError) or (
                isinstance(error, TypeError) and _WRONG_CALL.search(str(error))
            ):
                self._wrong.append(problem)

    def rehearse(self, outcome: TrialOutcome | None = None) -> list[str]:
        """Make all results of a trial, None: of no trial, and write none; returns why some would be left out.

        Raises ConfigurationError for what fails with more trials, too: measures of a trial, and wrong arguments.
        """
        if outcome is not None:
            self.add(outcome)
        wrong = [*self._problems]
        if not wrong:
            self._results()
            wrong = self._wrong
        if wrong:
            raise ConfigurationError("\n".join(wrong))
        return [*self._problems]


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


def _expected(value: Any, kind: type[Expected], what: str) -> Expected:
    """The value; raises ConfigurationError if it is of another type. what: is expected"""
    if not isinstance(value, kind):
        raise ConfigurationError(f"found {value!r:.120}, expected {what}")
    return value


def _named(measures: Any) -> dict[str, Any]:
    """The measures of a trial; raises ConfigurationError unless they have names, and OverflowError for huge numbers."""
    if not isinstance(measures, Mapping) or not all(isinstance(name, str) for name in measures):
        raise ConfigurationError(f"found {measures!r:.120}, expected a dict of values by name")
    for value in measures.values():
        if isinstance(value, Real):
            float(value)
    return dict(measures)


#: Files of every study.
_TAKEN = ("table", "results", "frames", "study", "report", "search", "candidates")


def _file_name(name: str) -> str:
    """The name of files in a study's folder; raises ConfigurationError for one that cannot be, or is taken."""
    if not is_name(name) or name in _TAKEN:
        expected = f"one that can name a file, and none of {', '.join(_TAKEN)}"
        raise ConfigurationError(f"found the name {name!r:.120}, expected {expected}")
    return name


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
