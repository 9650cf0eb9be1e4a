"""docs/explanation-determinism.md describes the states and transitions that the code has."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from planted_bugs import PLANTS
from test_found_schedules import FOUND

from mast_zenoh.launch import launcher_protocol
from mast_zenoh.mesh import host
from mast_zenoh.mesh.protocol import driver, node, pacer, rewiring, traffic
from mast_zenoh.testing.simulation import SimulatedWorld, play, random_schedule
from mast_zenoh.testing.simulation.processes import SimulatedProcess
from mast_zenoh.testing.simulation.simulation import Simulation

PAGE = (Path(__file__).parents[2] / "docs" / "explanation-determinism.md").read_text()
MODULES = (launcher_protocol, host, driver, node, pacer, rewiring, traffic)


def section(title: str) -> str:
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def column(text: str, title: str) -> set[str]:
    """The first column of the table with this title."""
    table = text.split(f"| {title} |")[1].split("\n\n")[0]
    return {line.split("|")[1].strip(" `") for line in table.splitlines()[2:]}


Edges = set[tuple[str, str]]


def edges(title: str) -> Edges:
    """The transitions between different states in the diagram of a section."""
    diagram = section(title).split("```mermaid")[1].split("```")[0]
    return {(before, after) for before, after in re.findall(r"(\w+) --> (\w+)", diagram) if before != after}


def transitions(
    worlds: dict[str, SimulatedWorld], seeds: Iterable[int], monkeypatch: pytest.MonkeyPatch
) -> list[Edges]:
    """The transitions of nodes, and of drivers, in simulated runs."""
    of_nodes, of_drivers = set[tuple[str, str]](), set[tuple[str, str]]()
    handle = Simulation.handle

    def observed(self: Simulation, process: SimulatedProcess, event: Any) -> None:
        protocol = process.protocol
        states = (protocol.state, getattr(protocol, "driver_state", None))
        handle(self, process, event)
        after = (protocol.state, getattr(protocol, "driver_state", None))
        for seen, before, now in zip((of_nodes, of_drivers), states, after, strict=True):
            if before is not now:
                seen.add((before.value.replace(" ", "_"), now.value.replace(" ", "_")))

    monkeypatch.setattr(Simulation, "handle", observed)
    for world in worlds.values():
        for seed in seeds:
            play(world, random_schedule(seed, world))
    return [of_nodes, of_drivers]


@pytest.mark.parametrize(("title", "states"), [("A node's process", node.State), ("The driver", driver.DriverState)])
def test_the_page_has_every_state_and_no_other(title: str, states: type[node.State]) -> None:
    names = {state.value.replace(" ", "_") for state in states}
    assert column(section(title), "state") == {name for edge in edges(title) for name in edge} == names


DIAGRAMS = ("A node's process", "The driver")


def test_the_diagrams_have_every_transition_of_simulated_runs(worlds, monkeypatch) -> None:
    for title, seen in zip(DIAGRAMS, transitions(worlds, range(15), monkeypatch), strict=True):
        assert len(seen) > 6
        assert seen <= edges(title)


@pytest.mark.heavy
def test_the_diagrams_have_no_transition_that_many_simulated_runs_never_make(worlds, monkeypatch) -> None:
    richest = {name: worlds[name] for name in ("steps", "realtime")}
    for title, seen in zip(DIAGRAMS, transitions(richest, range(200), monkeypatch), strict=True):
        assert seen == edges(title)


def test_every_transition_that_keeps_a_promise_exists() -> None:
    named = re.findall(r"`(\w+)\.(\w+)`", section("What keeps each promise"))
    assert len(named) > 15
    for owner, member in named:
        owners = [getattr(module, owner) for module in MODULES if hasattr(module, owner)]
        assert any(hasattr(found, member) for found in owners), f"{owner}.{member}"


def test_every_bug_that_breaks_a_promise_is_planted() -> None:
    rows = [line for line in section("What keeps each promise").splitlines() if line.startswith("| ")]
    bugs = {bug for row in rows for bug in re.findall(r"`(\w+)`", row.split("|")[3])}
    assert len(bugs) > 20
    planted = {plant.__name__ for plant in (*PLANTS, *(plant for plant, _, _ in FOUND))}
    assert bugs <= planted
