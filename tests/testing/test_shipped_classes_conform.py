"""Every shipped class passes the checks for user-defined classes."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh import attacks, faults, fusion, links, metrics, testing, tracking
from mast_zenoh.config import bundle, loading, registry

#: Values of required parameters.
NEEDED: dict[str, Any] = {
    "at": 1.0,
    "until": 2.0,
    "node": "ego",
    "probability": 0.3,
    "mean_s": 0.05,
    "by_s": 0.1,
    "delay_s": 0.1,
    "offset_s": 0.2,
    "bits_per_s": 1e6,
    "good_to_bad": 0.1,
    "bad_to_good": 0.3,
    "range_m": 50.0,
    "gateways": [(0.0, 0.0, 10.0)],
    "rule": dict(type="Loss", probability=0.5),
}


def shipped(base: type) -> list[Any]:
    """Shipped classes that can be named where a base is expected."""
    classes = registry.known_types(base).items()
    return [pytest.param(cls, base, id=name) for name, cls in classes if cls.__module__.startswith("mast_zenoh.")]


def made(cls: type, base: type) -> Any:
    """An object built like in a scenario."""
    parameters = inspect.signature(cls).parameters
    required = {name for name, each in parameters.items() if each.default is each.empty}
    arguments = {name: NEEDED[name] for name in required | (parameters.keys() & {"until", "node", "gateways"})}
    return registry.build({"type": cls, **arguments}, base, cls.__name__)


CHECKS: dict[type, Callable[[Any], None]] = {
    attacks.Attack: testing.check_attack,
    tracking.Tracker: testing.check_tracker,
    fusion.Clusterer: testing.check_clusterer,
    fusion.Fusion: testing.check_fusion,
    metrics.Metric: testing.check_metric,
    links.Rule: testing.check_link_rule,
    faults.Fault: testing.check_fault,
}


@pytest.mark.parametrize(("cls", "base"), [each for base in CHECKS for each in shipped(base)])
def test_a_shipped_class_conforms(cls: type, base: type) -> None:
    CHECKS[base](made(cls, base))


@pytest.mark.parametrize("file", sorted((bundle.ROOT / "nodes").glob("*.py")), ids=lambda file: file.stem)
def test_a_shipped_node_conforms(file: Path) -> None:
    testing.check_node(loading.node_class(file))


@pytest.mark.parametrize("name", ["uncoordinated", "realistic_network"])
def test_a_shipped_scenario_is_the_same_in_every_delivery_order(name: str) -> None:
    testing.check_scenario(name, frames=15, n_infrastructure=2)


@pytest.mark.mesh
def test_a_shipped_scenario_is_the_same_on_the_mesh() -> None:
    testing.check_scenario("coordinated", frames=10, mesh=True, n_infrastructure=2)
