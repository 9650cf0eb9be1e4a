"""What the nodes of a run report to the launcher: failures of handlers as they happen, and their results at the end."""

from __future__ import annotations

import hashlib
import queue
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.config.resolved import DRIVER_ROLE
from mast_zenoh.control import files
from mast_zenoh.control import reports as control
from mast_zenoh.control.failures import Entry, merged
from mast_zenoh.control.invalid import InvalidMessages
from mast_zenoh.errors import MessageError
from mast_zenoh.launch.supervisor import Child

#: Reports of one node that may wait to be looked at; a node of ours sends results one at a time.
MAX_WAITING = {"result": 2, "failed": 1000}

#: Processes that may have been one node, one after the other, and have reported failures.
MAX_PROCESSES = 64


class Report(NamedTuple):
    """Something a node has reported: the first failure of a handler in its process, or, without one, its results."""

    node: str
    failure: Entry | None = None


class Reports:
    """Collects the reports of all nodes, from when it is made until it is closed.

    control:  where the control keys of the run begin
    children: the nodes of the run by name; reports in other names are strangers', and refused
    invalid:  counts what is refused: malformed, too long, too many, of strangers, results given twice
    outcomes: what each node has handed in last
    """

    def __init__(
        self, session: zenoh.Session, control: str, children: Mapping[str, Child], invalid: InvalidMessages
    ) -> None:
        self.outcomes: dict[str, dict[str, Any]] = {}
        self._children = children
        self._invalid = invalid
        self._failures: dict[str, dict[str, dict[str, Entry]]] = {}  # by node, process and handler
        self._taken: dict[str, bytes] = {}  # by node the digest of what it has handed in
        self._came: queue.SimpleQueue[tuple[str, str, Any]] = queue.SimpleQueue()
        self._waiting: Counter[tuple[str, str]] = Counter()
        self._lock = threading.Lock()
        direct = zenoh.handlers.Callback
        result: Any = direct(self._on_result, indirect=False)
        failed: Any = direct(self._on_failed, indirect=False)
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
            what, node, report = self._came.get()
            with self._lock:
                self._waiting[what, node] -= 1
            try:
                yield from (self._take_failure if what == "failed" else self._take_result)(node, *report)
            except MessageError as error:
                self._invalid.note(f"{what}/{node}", error)

    def by_node(self) -> dict[str, dict[str, Any]]:
        """What each node has handed in last, with the failures in all processes that have been this node."""
        return {
            node: self.outcomes.get(node, {})
            | {"failures": merged(list(entries.values()) for entries in self._failures.get(node, {}).values())}
            for node in self._children
        }

    # Reports are decoded in Zenoh's threads, where they come: what is none takes nobody's room.

    def _on_result(self, query: zenoh.Query) -> None:
        with query:
            node = str(query.key_expr).rpartition("/")[2]
            payload = query.payload.to_bytes() if query.payload else b""
            try:
                drives = self._child("result", node).spec.role == DRIVER_ROLE
                outcome = control.decode_result(payload, node, drives=drives)
                self._put("result", node, (outcome, hashlib.sha256(payload).digest()))
            except MessageError as error:
                self._refuse("result", node, error)
                query.reply_err(files.encode_refusal(error))
            else:
                query.reply(query.key_expr, b"taken")

    def _on_failed(self, sample: zenoh.Sample) -> None:
        node = str(sample.key_expr).rpartition("/")[2]
        try:
            self._child("failed", node)
            self._put("failed", node, control.decode_failure(sample.payload.to_bytes()))
        except MessageError as error:
            self._refuse("failed", node, error)

    def _child(self, what: str, node: str) -> Child:
        if node not in self._children:
            raise MessageError(f"{what}: there is no node {node!r:.80} in this run")
        return self._children[node]

    def _put(self, what: str, node: str, report: tuple[Any, ...]) -> None:
        """Keep a report until the launcher's loop takes it."""
        with self._lock:
            if self._waiting[what, node] >= MAX_WAITING[what]:
                raise MessageError(f"{what}: more than {MAX_WAITING[what]} wait to be looked at")
            self._waiting[what, node] += 1
        self._came.put((what, node, report))

    def _refuse(self, what: str, node: str, error: MessageError) -> None:
        self._invalid.note(f"{what}/{node if node in self._children else '*'}", error)

    def _take_failure(self, node: str, process: str, entry: Entry) -> Iterator[Report]:
        of_process = self._of_process(node, process)
        first = entry["handler"] not in of_process
        if first and len(of_process) >= control.MAX_HANDLERS:
            raise MessageError(f"failed: more than {control.MAX_HANDLERS} handlers of one process")
        of_process[entry["handler"]] = entry
        if first:
            yield Report(node, entry)

    def _take_result(self, node: str, outcome: dict[str, Any], digest: bytes) -> Iterator[Report]:
        """The results of a node: one per life of it. The same again is a question whose answer got lost."""
        child = self._children[node]
        if child.handed_in:
            if self._taken.get(node) != digest:
                raise MessageError("result: it has handed in its results before")
            return
        self._of_process(node, outcome["process"]).update({entry["handler"]: entry for entry in outcome["failures"]})
        self.outcomes[node], self._taken[node] = outcome, digest
        child.handed_in = True
        yield Report(node)

    def _of_process(self, node: str, process: str) -> dict[str, Entry]:
        """The failures in one of the processes that have been a node, by handler."""
        processes = self._failures.setdefault(node, {})
        if process not in processes and len(processes) >= MAX_PROCESSES:
            raise MessageError(f"failed: more than {MAX_PROCESSES} processes of one node")
        return processes.setdefault(process, {})
