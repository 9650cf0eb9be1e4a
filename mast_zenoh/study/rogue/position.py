"""What a compromised node knows about its run: nodes, roles and keys. Pure."""

from __future__ import annotations

from typing import Any, NamedTuple

from mast_zenoh.config.resolved import RECORDING, Resolved, driver_of
from mast_zenoh.wiring.model import Wiring

#: Part of every forged string that could become a file name: files with this name were written by an insider.
MARKER = "mast_forged_by_an_insider"


class Position(NamedTuple):
    """The position of a compromised node in its run.

    node:      its name
    driver:    the node that drives the scene
    roles:     role of every node, by name
    publishes, subscribes: its keys, without the run's prefix; foreign: all other keys
    wiring:    of the run, as JSON
    version:   of mast-zenoh on the launcher's host
    """

    node: str
    driver: str
    roles: dict[str, str]
    publishes: tuple[str, ...]
    subscribes: tuple[str, ...]
    foreign: tuple[str, ...]
    wiring: dict[str, Any]
    version: str

    @property
    def others(self) -> tuple[str, ...]:
        """All nodes but this one."""
        return tuple(name for name in self.roles if name != self.node)

    @property
    def files(self) -> tuple[str, ...]:
        """Paths that exist in every run folder, and some that lead out of it."""
        inside = ("run.json", "scenario.json", "wiring.json", "metrics.json", RECORDING, "logs/x.log", "messages.mcap")
        return (*inside, f"../{MARKER}", f"/tmp/{MARKER}", f"../../../../../../tmp/{MARKER}", f"~/{MARKER}", MARKER)


def position(resolved: Resolved, node: str, version: str) -> Position:
    """The position of a node in a scenario. version: the one that it reports."""
    wiring = Wiring.from_json(resolved.wiring)
    published = tuple(dict.fromkeys(leg.key for _, leg in wiring.legs() if leg.publisher.node == node))
    subscribed = tuple(dict.fromkeys(key for key, _, subscriber in wiring.flows() if subscriber == node))
    foreign = tuple(key for key in dict.fromkeys(wiring.keys()) if key not in (*published, *subscribed))
    roles = {name: spec.role for name, spec in resolved.nodes.items()}
    driver = driver_of(resolved.nodes)
    return Position(node, driver, roles, published, subscribed, foreign, resolved.wiring, version)
