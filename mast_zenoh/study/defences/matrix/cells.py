"""The cells of a matrix of defences and adversaries, as configurations of a study."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.study.defences.choices import Choice, has_budget, short_name
from mast_zenoh.study.defences.fault_presets import PREFIX, check_fault
from mast_zenoh.study.defences.placement import PLACEMENTS

#: The command centre without a defence: the reference of all others.
UNDEFENDED = "NoIntegrity"
#: Label of the configuration without defence and without attack.
BASELINE = f"{UNDEFENDED} alone"


@dataclass(frozen=True, slots=True)
class Cell:
    """One configuration of the matrix.

    defence, attack: short names; attack: "" without adversaries, or a fault: then faulty agents take their places
    n_adversaries, placement: how many agents are compromised, and which (`placement.PLACEMENTS`)
    budget:          lies per second of each adversary; None: the attack's own, or it has none
    """

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
    def label(self) -> str:
        """The label of its configuration."""
        if not self.attack:
            return f"{self.defence} alone"
        budget = "" if self.budget is None else f" budget {self.budget:g}"
        attack = self.attack.replace(":", " ")
        return f"{self.defence} {attack} {self.n_adversaries} {self.placement}{budget}"


def matrix_study(
    *,
    defences: Sequence[Choice],
    adversaries: Sequence[Choice],
    counts: Sequence[int],
    placements: Sequence[str],
    budgets: Sequence[float | None],
    parameters: Mapping[str, Any],
) -> dict[str, Any]:
    """The keys `runs`, `cells` and `baseline` of a study of every defence against every adversary.

    adversaries: none for runs without an attack alone
    counts: numbers of adversaries; 0 stands for one run per defence without an attack, and is always included
    budgets: of each adversary that has one;  parameters: of the scenario, for all runs
    Raises ConfigurationError.
    """
    for placement in placements:
        if placement not in PLACEMENTS:
            raise ConfigurationError(f"placements: found {placement!r}{nearest(placement, PLACEMENTS)}")
    for count in counts:
        if type(count) is not int or count < 0:
            raise ConfigurationError(f"counts: found {count!r}, expected whole numbers, 0 or more")
    if UNDEFENDED not in defences:  # the reference of all others
        defences = [UNDEFENDED, *defences]
    runs: dict[str, Any] = {}
    cells: dict[str, Cell] = {}
    for cell, defence, attack in _cells(defences, adversaries, counts, placements, budgets):
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
    defences: Sequence[Choice],
    adversaries: Sequence[Choice],
    counts: Sequence[int],
    placements: Sequence[str],
    budgets: Sequence[float | None],
) -> Iterator[tuple[Cell, Choice, Choice | None]]:
    """The cells, each with its defence and its attack."""
    for defence in defences:
        yield Cell(short_name(defence)), defence, None
        for attack in adversaries:
            own_budgets = budgets if has_budget(attack) else (None,)
            for count in sorted({*counts} - {0}):
                for placement in placements:
                    for budget in own_budgets:
                        yield Cell(short_name(defence), short_name(attack), count, placement, budget), defence, attack
