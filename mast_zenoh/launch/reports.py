"""What the nodes of a run report to the launcher: failures of handlers as they happen, and their results at the end."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import msgpack
import zenoh

from mast_zenoh.errors import MessageError
from mast_zenoh.launch.supervisor import Child
from mast_zenoh.runtime import results
from mast_zenoh.runtime.failures import Entry, checked, merged


class Report(NamedTuple):
    """Something a node has reported: the first failure of a handler in its process, or, without one, its results."""

    node: str
    failure: Entry | None = None


class Reports:
    """Collects the reports of all nodes, from when it is made until it is closed.

    control:  where the control keys of the run begin
    children: the nodes of the run by name; reports in other names are strangers', and ignored
    outcomes: what each node has handed in last
    """

    def __init__(self, session: zenoh.Session, control: str, children: Mapping[str, Child]) -> None:
        self.outcomes: dict[str, dict[str, Any]] = {}
        self._children = children
        self._failures: dict[str, dict[str, dict[str, Entry]]] = {}  # by node, process and handler
        self._came: queue.SimpleQueue[tuple[str, str, bytes]] = queue.SimpleQueue()
        direct = zenoh.handlers.Callback
        result: Any = direct(self._on_result, indirect=False)
        failed: Any = direct(lambda s: self._put("failed", s.key_expr, s.payload), indirect=False)
        self._declared: list[Any] = [
            session.declare_queryable(f"{control}/result/*", result),
            session.declare_subscriber(f"{control}/failed/*", failed),
        ]

    def close(self) -> None:
        """Collect no more."""
        for entity in self._declared:
            entity.undeclare()

    def take(self) -> Iterator[Report]:
        """The reports that have come since the last call, in their order."""
        while not self._came.empty():
            what, node, payload = self._came.get()
            if node not in self._children:
                continue
            try:
                yield from self._take_failure(node, payload) if what == "failed" else self._take_result(node, payload)
            except (MessageError, ValueError, TypeError, KeyError, msgpack.UnpackException):
                continue  # malformed: not sent by a node of this package

    def by_node(self) -> dict[str, dict[str, Any]]:
        """What each node has handed in last, with the failures in all processes that have been this node."""
        return {
            node: self.outcomes.get(node, {})
            | {"failures": merged(list(entries.values()) for entries in self._failures.get(node, {}).values())}
            for node in self._children
        }

    def _on_result(self, query: zenoh.Query) -> None:
        with query:
            self._put("result", query.key_expr, query.payload)
            query.reply(query.key_expr, b"taken")

    def _put(self, what: str, key: zenoh.KeyExpr, payload: zenoh.ZBytes | None) -> None:
        self._came.put((what, str(key).rpartition("/")[2], payload.to_bytes() if payload else b""))

    def _take_failure(self, node: str, payload: bytes) -> Iterator[Report]:
        process, entry = msgpack.unpackb(payload)
        of_process = self._failures.setdefault(node, {}).setdefault(str(process), {})
        first = checked(entry)["handler"] not in of_process
        of_process[entry["handler"]] = entry
        if first:
            yield Report(node, entry)

    def _take_result(self, node: str, payload: bytes) -> Iterator[Report]:
        outcome = results.unpack(payload)
        results.checked(outcome["results"])
        entries = {checked(entry)["handler"]: entry for entry in outcome["failures"]}
        self.outcomes[node] = outcome
        self._children[node].handed_in = True
        self._failures.setdefault(node, {})[str(outcome["process"])] = entries
        yield Report(node)
