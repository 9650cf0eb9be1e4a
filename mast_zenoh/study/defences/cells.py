"""What study files import of the kinds of studies of defences, which load more: their cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.study.defences.choices import PLACEMENTS, PREFIX, Choice, check_fault, has_budget, short_name
from mast_zenoh.study.defences.kinds import DefenceCell

#: The command centre without a defence: the reference of all others.
UNDEFENDED = "NoIntegrity"
#: Label of the configuration without defence and without attack.
BASELINE = f"{UNDEFENDED} alone"


@dataclass(frozen=True, slots=True)
class Cell(DefenceCell):
    """One configuration of the matrix.

    defence, attack: short names; attack: "" without adversaries, or a fault: then faulty agents take their places
    n_adversaries, placement: how many agents are compromised, and which (`choices.PLACEMENTS`)
    budget:          lies per second of each adversary; None: the attack's own, or it has none
    """

    kind = "matrix"

    defence: str
    attack: str = ""
    n_adversaries: int = 0
    placement: str = ""
    budget: float | None = None

    @property
    def is_fault(self) -> bool:
        """Whether its agents are faulty and nobody lies."""
        return self.attack.startswith(PREFIX)

    @property
    def lies(self) -> bool:
        """Whether it has adversaries."""
        return bool(self.attack) and not self.is_fault

    @property
    def undefended(self) -> Cell:
        """The same without a defence."""
        return replace(self, defence=UNDEFENDED)

    @property
    def alone(self) -> Cell:
        """The same defence without an attack."""
        return replace(self, attack="", n_adversaries=0, placement="", budget=None)

    @property
    def label(self) -> str:
        """The label of its configuration."""
        if not self.attack:
            return f"{self.defence} alone"
        budget = "" if self.budget is None else f" budget {self.budget:g}"
        attack = self.attack.replace(":", " ")
        return f"{self.defence} {attack} {self.n_adversaries} {self.placement}{budget}"


@dataclass(frozen=True, slots=True)
class FieldCell(Cell):
    """A cell of this matrix; attack_start_s: s of scene time."""

    kind = "field_matrix"

    attack_start_s: float = 0.0


@dataclass(frozen=True, slots=True)
class BreakdownCell(DefenceCell):
    """A number of liars among a number of agents, the ego included.

    attack: its short name; "" without liars;  attack_start_s: s of scene time
    """

    kind = "breakdown"

    attack: str
    agents: int
    liars: int
    attack_start_s: float

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return (
            f"{self.agents} agents {self.attack} {self.liars}" if self.liars else f"{self.agents} agents without liars"
        )


@dataclass(frozen=True, slots=True)
class DriftCell(DefenceCell):
    """One liar that displaces one object at a time.

    offset_m: the largest offset;  rate_mps: m/s by which it grows; None: at once
    agents:   number of agents, the ego included
    """

    kind = "drift"

    offset_m: float
    rate_mps: float | None = None
    agents: int = 5

    @property
    def label(self) -> str:
        """The label of its configuration."""
        lie = f"offset {self.offset_m:g} m" if self.rate_mps is None else f"drift {self.rate_mps:g} mps"
        return f"{self.agents} agents {lie}"


@dataclass(frozen=True, slots=True)
class CooperationCell(DefenceCell):
    """A fusion architecture and a number of agents, the ego included.

    attacked: whether some of them lie;  attack_start_s: s of scene time, from which trials count, with lies or without
    """

    kind = "cooperation"

    architecture: str
    agents: int
    attacked: bool
    attack_start_s: float

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return f"{self.architecture} {self.agents} agents{' attacked' if self.attacked else ''}"


@dataclass(frozen=True, slots=True)
class DrivingCell(DefenceCell):
    """One attack and one defence.

    attack: its name; "": none;  wire: where it is;  defence: its name; "": none
    car:    whose consequences count
    """

    kind = "driving_matrix"

    attack: str
    wire: str
    defence: str
    car: str = "ego"

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return f"{f'{self.attack} on {self.wire}' if self.attack else 'no attack'}, {self.defence or 'no defence'}"


def matrix_study(
    *,
    defences: Sequence[Choice],
    adversaries: Sequence[Choice],
    counts: Sequence[int],
    placements: Sequence[str],
    budgets: Sequence[float | None],
    parameters: Mapping[str, Any],
    cell_type: Callable[..., Cell] = Cell,
) -> dict[str, Any]:
    """The keys `runs`, `cells` and `baseline` of a study of every defence against every adversary.

    adversaries: none for runs without an attack alone
    counts: numbers of adversaries; 0 stands for one run per defence without an attack, and is always included
    budgets: of each adversary that has one;  parameters: of the scenario, for all runs
    cell_type: makes the cells, with the parameters of `Cell`
    Raises ConfigurationError.
    """
    for placement in placements:
        if placement not in PLACEMENTS:
            raise ConfigurationError(f"placements: found {placement!r}{nearest(placement, PLACEMENTS)}")
    for count in counts:
        if type(count) is not int or count < 0:
            raise ConfigurationError(f"counts: found {count!r}, expected whole numbers, 0 or more, such as [1, 2]")
    if UNDEFENDED not in defences:  # the reference of all others
        defences = [UNDEFENDED, *defences]
    runs: dict[str, Any] = {}
    cells: dict[str, Cell] = {}
    for cell, defence, attack in _cells(cell_type, defences, adversaries, counts, placements, budgets):
        if cell.label in cells:
            raise ConfigurationError(f"two configurations are called {cell.label!r}: expected each choice once")
        own: dict[str, Any] = {"defence": defence, "n_adversaries": cell.n_adversaries}
        if attack is not None:
            own |= _attacked(cell, attack)
        runs[cell.label] = {"scenario": "defence_cell", "parameters": {**parameters, **own}}
        cells[cell.label] = cell
    return {"runs": runs, "cells": cells, "baseline": BASELINE}


def _attacked(cell: Cell, attack: Choice) -> dict[str, Any]:
    """The parameters of a scenario with adversaries, or with faulty agents in their places."""
    if isinstance(attack, str) and attack.startswith(PREFIX):
        fault = attack.removeprefix(PREFIX)
        check_fault(fault)
        return {"n_adversaries": 0, "fault": fault, "n_faulty": cell.n_adversaries, "placement": cell.placement}
    return {"attack": attack, "placement": cell.placement, "budget": cell.budget}


def _cells(
    cell_type: Callable[..., Cell],
    defences: Sequence[Choice],
    adversaries: Sequence[Choice],
    counts: Sequence[int],
    placements: Sequence[str],
    budgets: Sequence[float | None],
) -> Iterator[tuple[Cell, Choice, Choice | None]]:
    """The cells, each with its defence and its attack."""
    for defence in defences:
        yield cell_type(short_name(defence)), defence, None
        for attack in adversaries:
            own_budgets = budgets if has_budget(attack) else (None,)
            for count in sorted({*counts} - {0}):
                for placement in placements:
                    for budget in own_budgets:
                        cell = cell_type(short_name(defence), short_name(attack), count, placement, budget)
                        yield cell, defence, attack
