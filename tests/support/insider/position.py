"""What a compromised node knows about its run, and valid control messages of it."""

from typing import Any, NamedTuple

import msgpack

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


#: A failed handler.
FAILURE: dict[str, Any] = {
    "handler": "on_clock",
    "count": 3,
    "frames": 3,
    "first_frame": 1,
    "last_frame": 3,
    "exception": "KeyError: 'forged'",
    "where": f"/tmp/{MARKER}.py:1",
}
#: What a node that does not drive the scene reports at its end.
RESULT: dict[str, Any] = {
    "results": {"n": 1},
    "rejected": {"clock: forged": 2},
    "first_rejected": {"clock": [3, "forged"]},
    "foreign": {"clock": 1},
    "invalid": {"epoch": [1, "forged"]},
    "unsigned": 3,
    "process": "0123456789abcdef",
    "failures": [],
    "last_frame": 3,
    "cpu_s": 0.5,
    "arrived_ns": {"clock": {0: 1_700_000_000_000_000_000}},
    "versions": {"numpy": "2.0"},
    "clock": {"offset_ms": -1.5, "round_trip_ms": 0.1},
}


def valid_message(control: str, position: Position) -> Any:
    """A valid message of this kind, as plain values; a str for bare text."""
    return {
        "counts": [1, dict.fromkeys(position.publishes[:1], 3), dict.fromkeys(position.subscribes[:2], 3)],
        "epoch": [2, position.roles, None],
        "failed": ["0123456789abcdef", FAILURE],
        "act": [3, [["kill", position.others[0]]]],
        "result": RESULT | {"failures": [FAILURE]},
        "fetch": {"do": "piece", "path": "scenario.json", "offset": 0},
        "file": {"path": "messages.mcap", "offset": 0, "piece": MARKER.encode()},
        "rewire": {"wiring": position.wiring, "join": {}, "leave": [position.others[0]]},
        "intercept": [msgpack.packb({"do": "release", "number": "1", "name": None, "wire": "clock"}), b"\0" * 32],
        "stop": "end",
        "leave": "leave",
        "drain": (*position.subscribes, "clock")[0],
    }[control]
