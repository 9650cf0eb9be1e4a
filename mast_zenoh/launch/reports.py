"""Reports of nodes to the launcher: failures of handlers, and results at the end."""

from __future__ import annotations

import hashlib
import queue
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

import zenoh

from mast_zenoh.config.resolved import DRIVER_ROLE
from mast_zenoh.errors import MessageError
from mast_zenoh.launch.launcher_protocol import Report
from mast_zenoh.launch.supervisor import Child
from mast_zenoh.launch.table_files import TableFiles
from mast_zenoh.mesh.control import files
from mast_zenoh.mesh.control.codec import InvalidMessages
from mast_zenoh.mesh.control.failures import MAX_HANDLERS, Entry, decode_failure, merged
from mast_zenoh.mesh.control.key_marks import check_control_mark
from mast_zenoh.mesh.control.results import TablePart, decode_part, decode_result, is_part
from mast_zenoh.mesh.session import direct

#: Reports of one node in the queue. An honest node sends results, and parts of tables, one at a time; a part that is
#: not answered in time again.
MAX_WAITING = {"result": 2, "part": 8, "failed": 1000}

#: Processes of one node, one after the other, that may report failures.
MAX_PROCESSES = 64


class Reports:
    """Collects the reports of all nodes until it is closed.

    control:  prefix of the run's control keys
    children: the nodes of the run by name; reports under other names are refused
    invalid:  counts refused reports: malformed, too long, too many, of unknown nodes, results handed in twice
    tables:   where parts of tables go
    outcomes: what each node handed in last
    last_part_s: by node, when its last part of a table arrived, s on the monotonic clock
    """

    def __init__(
        self,
        session: zenoh.Session,
        control: str,
        children: Mapping[str, Child],
        invalid: InvalidMessages,
        tables: TableFiles,
    ) -> None:
        self.last_part_s: dict[str, float] = {}
        self._tables = tables
        self.outcomes: dict[str, dict[str, Any]] = {}
        self._children = children
        self._invalid = invalid
        self._failures: dict[str, dict[str, dict[str, Entry]]] = {}  # by node, process and handler
        self._digests: dict[str, bytes] = {}  # by node, the digest of what it handed in last
        self._queue: queue.SimpleQueue[tuple[str, str, Any]] = queue.SimpleQueue()
        self._waiting: Counter[tuple[str, str]] = Counter()
        self._lock = threading.Lock()
        self._declared: list[Any] = [
            session.declare_queryable(f"{control}/result/*", direct(self._on_result)),
            session.declare_subscriber(f"{control}/failed/*", direct(self._on_failed)),
        ]

    def close(self) -> None:
        """Stop collecting."""
        for entity in self._declared:
            entity.undeclare()

    def take(self) -> Iterator[Report]:
        """The reports since the last call, in order of arrival."""
        while not self._queue.empty():
            kind, node, report = self._queue.get()
            with self._lock:
                self._waiting[kind, node] -= 1
            take: Any = {"failed": self._take_failure, "result": self._take_result, "part": self._take_part}[kind]
            try:
                yield from take(node, *report)
            except MessageError as error:
                self._invalid.note(f"{kind}/{node}", error)

    def by_node(self) -> dict[str, dict[str, Any]]:
        """What each node handed in last, with the failures of all its processes."""
        return {
            node: self.outcomes.get(node, {})
            | {"failures": merged(list(entries.values()) for entries in self._failures.get(node, {}).values())}
            for node in self._children
        }

    # Reports are decoded on arrival, in Zenoh's threads: malformed ones never enter the queue.

    def _on_result(self, query: zenoh.Query) -> None:
        node = str(query.key_expr).rpartition("/")[2]
        payload = query.payload.to_bytes() if query.payload else b""
        if is_part(payload):
            self._on_part(query, node, payload)
            return
        with query:
            try:
                check_control_mark(query.key_expr, query.attachment)
                drives = self._child("result", node).spec.role == DRIVER_ROLE
                outcome = decode_result(payload, node, drives=drives)
                self._put("result", node, (outcome, hashlib.sha256(payload).digest(), self._children[node].restarts))
            except MessageError as error:
                self._refuse("result", node, error)
                query.reply_err(files.encode_refusal(error))
            else:
                query.reply(query.key_expr, b"taken")

    def _on_part(self, query: zenoh.Query, node: str, payload: bytes) -> None:
        """Queue a part with its query, which is answered when it is written: so few parts are in memory."""
        try:
            check_control_mark(query.key_expr, query.attachment)
            self._child("result", node)
            try:
                self._put("part", node, (query, *decode_part(payload)))
            except MessageError as error:
                self._tables.incomplete.setdefault(node, str(error))
                raise
        except MessageError as error:
            self._refuse("result", node, error)
            _answer(query, error)

    def _on_failed(self, sample: zenoh.Sample) -> None:
        node = str(sample.key_expr).rpartition("/")[2]
        try:
            check_control_mark(sample.key_expr, sample.attachment)
            self._child("failed", node)
            self._put("failed", node, decode_failure(sample.payload.to_bytes()))
        except MessageError as error:
            self._refuse("failed", node, error)

    def _child(self, kind: str, node: str) -> Child:
        if node not in self._children:
            raise MessageError(f"{kind}: there is no node {node!r:.80} in this run")
        return self._children[node]

    def _put(self, kind: str, node: str, report: tuple[Any, ...]) -> None:
        """Queue a report for the launcher's loop."""
        with self._lock:
            if self._waiting[kind, node] >= MAX_WAITING[kind]:
                raise MessageError(f"{kind}: more than {MAX_WAITING[kind]} reports are waiting")
            self._waiting[kind, node] += 1
        self._queue.put((kind, node, report))

    def _refuse(self, kind: str, node: str, error: MessageError) -> None:
        self._invalid.note(f"{kind}/{node if node in self._children else '*'}", error)

    def _take_part(self, node: str, query: zenoh.Query, process: str, part: TablePart) -> Iterator[Report]:
        problem: MessageError | None = None
        try:
            self._tables.add(node, process, part)
            self.last_part_s[node] = time.monotonic()
        except MessageError as error:
            problem = error
        _answer(query, problem)
        if problem is not None:
            raise problem
        yield from ()

    def _take_failure(self, node: str, process: str, entry: Entry) -> Iterator[Report]:
        by_handler = self._entries_of(node, process)
        first = entry["handler"] not in by_handler
        if first and len(by_handler) >= MAX_HANDLERS:
            raise MessageError(f"failed: more than {MAX_HANDLERS} handlers of one process")
        by_handler[entry["handler"]] = entry
        if first:
            yield Report(node, entry)

    def _take_result(self, node: str, outcome: dict[str, Any], digest: bytes, restarts: int) -> Iterator[Report]:
        """Take a node's results, once per process.

        The same results again are ignored: the node repeats them if the reply got lost. So are those of a process that
        was replaced after they arrived. restarts: of the node by then
        """
        child = self._children[node]
        if child.restarts != restarts:
            return
        if child.handed_in:
            if self._digests.get(node) != digest:
                raise MessageError("result: it has handed in its results before")
            return
        self._entries_of(node, outcome["process"]).update({entry["handler"]: entry for entry in outcome["failures"]})
        self.outcomes[node], self._digests[node] = outcome, digest
        child.handed_in = True
        yield Report(node, stop_reason=outcome.get("stop_reason"))

    def _entries_of(self, node: str, process: str) -> dict[str, Entry]:
        """The failures in one of a node's processes, by handler."""
        processes = self._failures.setdefault(node, {})
        if process not in processes and len(processes) >= MAX_PROCESSES:
            raise MessageError(f"failed: more than {MAX_PROCESSES} processes of one node")
        return processes.setdefault(process, {})


def _answer(query: zenoh.Query, problem: MessageError | None) -> None:
    """Answer a query, unless its node has gone."""
    with suppress(zenoh.ZError):
        if problem is None:
            query.reply(query.key_expr, b"taken")
        else:
            query.reply_err(files.encode_refusal(problem))
    query.drop()
