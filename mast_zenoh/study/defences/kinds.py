"""The kinds of studies of defences: what is evaluated in each trial, and what is collected from all of them.

A new kind is a folder with its cells, its evaluation and its collection, and a line in KINDS.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from mast_zenoh.study.defences.breakdown.cell import BreakdownCell
from mast_zenoh.study.defences.drift.cell import DriftCell
from mast_zenoh.study.defences.matrix.cells import Cell
from mast_zenoh.study.defences.study_files import StudyFiles
from mast_zenoh.study.trial import Outcome


class Collection(Protocol):
    """Collects the trials of a study, and writes its tables and figures."""

    def add(self, outcome: Outcome) -> None:
        """Add a finished trial."""

    def write(self, folder: Path) -> StudyFiles:
        """Write the files into the study's folder."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of study of defences.

    name:       of the kind, and of its folder in this package
    cell:       class of its cells: what differs between its configurations
    collection: class in its module `collection`, see `Collection`; made from the cells by label of configuration, and
                the scenes and seeds planned for every cell
    recorded:   whether its evaluation needs all messages of a run
    undisturbed: in its module `records`, the name of the part `defence` of a trial in which nothing lies and nothing is
                faulty, which is then neither recorded nor evaluated; "": every trial is evaluated

    The function `evaluate` of its module `trial` evaluates a trial. These modules are loaded when they are needed:
    SciPy's statistics and drawing libraries are slow to load.
    """

    name: str
    cell: type
    collection: str
    recorded: bool = False
    undisturbed: str = ""

    def evaluate(self, folder: Path, metrics: Mapping[str, Any], compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        folder: of the run;  compromised: names of the agents with an adversary, whether it lied or not
        """
        part: dict[str, Any] = self._module("trial").evaluate(folder, metrics, compromised)
        return part

    def without_lies(self) -> dict[str, Any]:
        """The part `defence` of a trial in which nothing lies and nothing is faulty; only with `undisturbed`."""
        part: dict[str, Any] = getattr(self._module("records"), self.undisturbed)
        return part

    def collect(self, cells: Mapping[str, Any], scenes: Sequence[str], seeds: Sequence[int]) -> Collection:
        """An empty collection; cells: by label of configuration;  scenes, seeds: planned for every cell."""
        collection: Collection = getattr(self._module("collection"), self.collection)(cells, scenes, seeds)
        return collection

    def _module(self, name: str) -> Any:
        return import_module(f"{__package__}.{self.name}.{name}")


#: All kinds. The matrix is recorded because messages have the sizes of false objects, which decide how many agents
#: would see them. Without a recording, every false object counts as a car (`api.observability`): under `coordinated`,
#: this changes `outnumbered`.
KINDS = (
    Kind("matrix", Cell, "MatrixCollection", recorded=True, undisturbed="NO_LIES"),
    Kind("drift", DriftCell, "DriftCollection"),
    Kind("breakdown", BreakdownCell, "BreakdownCollection"),
)


def kind_of(cell: object) -> Kind | None:
    """The kind of study that has such cells; None if there is none."""
    return next((kind for kind in KINDS if isinstance(cell, kind.cell)), None)


def kind_named(name: str) -> Kind:
    """The kind of study with a name; raises KeyError for an unknown one."""
    return {kind.name: kind for kind in KINDS}[name]
