"""A run that plays while somebody without a role in it attacks: the attacker's access, and what each attempt achieves.

`compare` makes the attempts of a study file at every security level (docs/explanation-security.md).
"""

from __future__ import annotations

import itertools
import json
import select
import socket
import socketserver
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from rich.console import Console

from mast_zenoh import run_folder, scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, HandlerFailed, Interrupted, MastError, RunError, nearest
from mast_zenoh.launch import run
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.mesh.control import failures, prefix
from mast_zenoh.mesh.control.failures import described
from mast_zenoh.mesh.security.authority import Authority
from mast_zenoh.mesh.security.credentials import Credentials
from mast_zenoh.mesh.security.levels import endpoint
from mast_zenoh.mesh.session import open_client
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import SCHEMAS, Header, Message, text
from mast_zenoh.show.tables.text_table import ResultTables, TextTable
from mast_zenoh.study.definition import Attempt, Study
from mast_zenoh.study.store import new_folder, status_written
from mast_zenoh.wiring.model import Wiring

OUTSIDER = "outsider"
#: The row of messages that belong to no attempt; their number should be 0.
STRAY = "(anything else)"
FILES = ("attempts.md", "attempts.csv")
ABOUT = "At each level an outsider made all attempts of a table in one run: see docs/explanation-security.md."
CAPTION = "in: forged messages that reached a node; out: samples overheard; lured: nodes at the outsider's router."

_JOIN_MS = 1500
_START_S, _END_S, _FRAME_S, _FLUSH_S, _POLL_S = 60.0, 30.0, 10.0, 0.5, 0.02


@dataclass
class Outcome:
    """What one attempt achieved.

    admitted: whether the outsider got a session on the mesh
    sent:     messages forged; reached: how many deliveries to hosts there were, of `expected` if none is lost
    heard:    samples (or replies) overheard
    lured:    nodes that connected to the outsider's router
    """

    admitted: bool = False
    sent: int = 0
    reached: int = 0
    expected: int = 0
    heard: int = 0
    lured: int = 0

    @property
    def succeeded(self) -> bool:
        """Whether any message was injected, overheard or diverted."""
        return bool(self.reached or self.heard or self.lured)


class AttackedRun:
    """A context manager: on entry the run has played its first frames; on exit it has ended.

    resolved: the run; level: security level of its mesh; folder: its run folder
    lured: nodes whose connection to the router passes through the outsider, each in one of `detours`
    """

    def __init__(self, resolved: Resolved, folder: Path, level: str, lured: Collection[str] = ()) -> None:
        self.level = level
        self.resolved = resolved
        self.wiring = Wiring.from_json(resolved.wiring)
        self.detours = {self._node(name): Detour(lambda: self.endpoint) for name in lured}
        self.crash = ""  # the exception that ended the launcher, if any
        self._context: RunContext | None = None
        self._ended: run.EndedRun | None = None
        self._thread = threading.Thread(target=self._play, args=(folder,), name="attacked-run")

    def __enter__(self) -> AttackedRun:
        self._thread.start()
        try:
            self.wait(lambda: self.frame >= 1, _START_S, "the run has begun")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        for detour in self.detours.values():
            detour.shutdown()
            detour.server_close()

    # -- knowledge and access of the outsider ----------------------------------------------------------------------

    @property
    def frame(self) -> int:
        """The newest frame that has begun; -1 before the first."""
        return -1 if self._context is None else self._context.frame

    @property
    def endpoint(self) -> str:
        """The router's endpoint.

        Addresses, the authority's certificate and the run's id are public.
        """
        return str(self._joined.record["endpoint"])

    @property
    def prefix(self) -> str:
        """The prefix of all keys of the run."""
        return prefix(self._joined.run_id)

    @cached_property
    def foreign(self) -> Authority:
        """The outsider's own authority, for certificates that imitate the real ones."""
        return Authority(self._joined.run_id)

    def credentials(self, shows: str) -> Credentials | None:
        """The credentials that an outsider presents, see `Attempt`; None on an open mesh."""
        deployment = self._mesh.deployment
        if deployment is None or deployment.authority is None or deployment.folder is None:
            return None
        public = Credentials(deployment.authority.pem)
        if shows == "nothing":
            return public
        if shows == "foreign":
            return replace(self.foreign.issue("infra_1"), authority=public.authority)
        if shows == "expired":
            now = datetime.now(UTC)
            return deployment.authority.issue("infra_1", begins=now - timedelta(hours=2), ends=now - timedelta(hours=1))
        return Credentials.read(deployment.folder / self._node(shows))

    @contextmanager
    def join(self, shows: str, zid: str | None = None) -> Iterator[zenoh.Session | None]:
        """A session on the mesh, with a Zenoh id if given; None if it is refused."""
        session = None
        with suppress(zenoh.ZError):
            session = open_client(self.endpoint, self.credentials(shows), try_ms=_JOIN_MS, zid=zid)
        with session or nullcontext():
            yield session

    def zid(self, node: str) -> str:
        """The Zenoh id of a node's session, which any client of an open mesh can query."""
        session = self._mesh.session
        key = f"@/{session.info.zid()}/router/token/{self.prefix}/alive/{self._node(node)}"
        for reply in session.get(key, timeout=5.0):
            if reply.ok is not None:
                return str(json.loads(reply.ok.payload.to_bytes())["clients"][0])
        raise RunError(f"the router knows no session of {node}")

    def receivers(self, key: str) -> int:
        """The number of nodes that receive messages on this key."""
        legs = [(wire, leg) for wire, leg in self.wiring.legs() if leg.key == key]
        return sum(len(wire.receivers(leg)) + len(self.wiring.overhearers) for wire, leg in legs)

    def put(self, session: zenoh.Session, key: str, payload: bytes) -> None:
        """Send a message, not through a declared publisher: it would send none on keys without known subscribers."""
        block = zenoh.CongestionControl.BLOCK
        session.put(f"{self.prefix}/{key}", payload, congestion_control=block, express=True)

    def forge(self, session: zenoh.Session | None, key: str, number: int) -> Outcome:
        """Send empty messages on the wire of this key, with OUTSIDER as their source, and wait until they arrive.

        A host that receives one therefore rejects and counts it. session: None: the outsider was refused
        """
        message = next((wire.message for wire, leg in self.wiring.legs() if leg.key == key), None)
        if message is None:
            raise ConfigurationError(f"outsider: no wire has the key {key!r}{nearest(key, self.wiring.keys())}")
        outcome = Outcome(session is not None, expected=number * self.receivers(key))
        if session is not None:
            columns = {
                column.name: text([])
                if column.dtype == "str"
                else np.zeros([0 if isinstance(size, str) else size for size in column.shape], column.dtype)
                for column in SCHEMAS[message].columns
            }
            for _ in range(number):
                header = Header(message, OUTSIDER, self.frame, 0, 0)
                self.put(session, key, codec.encode(Message(header, columns)))
            outcome.sent = number
            self.flush()
        return outcome

    # -- progress and outcome of the run ---------------------------------------------------------------------------

    def wait(self, condition: Callable[[], Any], seconds: float, description: str = "") -> bool:
        """Wait for a condition while the run plays; False after a timeout of `seconds`.

        description: if given, a timeout raises RunError with it. Raises RunError if the run has ended.
        """
        pause, deadline = threading.Event(), time.monotonic() + seconds
        while not condition():
            if not self._thread.is_alive():
                error = self.crash or (self._ended and self._ended.error)
                raise RunError(f"the run ended before the attackers had finished: {error or 'all frames are played'}")
            if time.monotonic() > deadline:
                if description:
                    raise RunError(f"timed out after {seconds:.0f} s, waiting until {description}")
                return False
            pause.wait(_POLL_S)
        return True

    def flush(self) -> None:
        """Wait until what was sent has arrived, if it arrives."""
        self.wait(lambda: False, _FLUSH_S)

    def next_frame(self) -> int:
        """Wait until another frame begins; returns it."""
        last = self.frame
        self.wait(lambda: self.frame > last, _FRAME_S, "the run continues")
        return self.frame

    def wait_until_ended(self, seconds: float) -> run.EndedRun | None:
        """Wait for the run to end by itself; its outcome, or None after `seconds`."""
        self._thread.join(seconds)
        return self._ended

    def stop(self) -> run.EndedRun | None:
        """Stop the run if it is still playing; its outcome."""
        if self._thread.is_alive() and self._context is not None:
            self._context.interrupt()
        return self.wait_until_ended(_END_S)

    def foreign_messages(self) -> Counter[str]:
        """Stop the run; returns by key how many messages from outside the run reached a node's host."""
        finished = self.stop()
        if finished is None or (finished.error is not None and not isinstance(finished.error, Interrupted)):
            reason = finished.error if finished else self.crash or "it did not stop"
            raise RunError(f"the attacked run failed: {reason}")
        if finished.failures:
            raise HandlerFailed(failures.summary(finished.failures, finished.logs))
        counts = Counter[str]()
        for name, node in finished.record["nodes"].items():
            if node["foreign"] is None:
                raise RunError(f"{name} reported no results: {node['ended']}")
            counts.update(node["foreign"])
        return counts

    def _play(self, folder: Path) -> None:
        def prepare(context: RunContext) -> None:
            context.detours |= {
                node: endpoint(self.level, f"tcp/127.0.0.1:{detour.server_address[1]}")
                for node, detour in self.detours.items()
            }
            self._context = context

        try:
            self._ended = run.run(self.resolved, folder, secure=self.level, prepare=prepare)
        except Exception as error:  # a defect that the attackers may have triggered
            self.crash = described(error)

    @property
    def _joined(self) -> RunContext:
        assert self._context is not None
        return self._context

    @property
    def _mesh(self) -> Mesh:
        assert self._joined.mesh is not None
        return self._joined.mesh

    def _node(self, name: str) -> str:
        """The name of a node of the run; raises ConfigurationError."""
        if name not in self.resolved.nodes:
            raise ConfigurationError(f"outsider: no node {name!r}{nearest(name, self.resolved.nodes)}")
        return name


def listen(session: zenoh.Session, keys: str) -> list[zenoh.Sample]:
    """All samples on these keys from now on: the list grows."""
    samples: list[zenoh.Sample] = []
    callback: Any = zenoh.handlers.Callback(samples.append, indirect=False)
    session.declare_subscriber(keys, callback)
    return samples


class Detour(socketserver.ThreadingTCPServer):
    """Relays connections byte for byte to an endpoint on this machine, until they are redirected to another.

    It models redirection in a real network (a forged ARP or DNS reply, a NAT rule), and needs no privileges.

    target: returns the endpoint; called for each connection
    """

    daemon_threads = True

    def __init__(self, target: Callable[[], str]) -> None:
        super().__init__(("127.0.0.1", 0), socketserver.BaseRequestHandler)
        self._target = target
        self._links: list[socket.socket] = []
        threading.Thread(target=self.serve_forever, name="detour", daemon=True).start()

    def redirect(self, endpoint: str) -> None:
        """Close all connections, and relay new ones to an endpoint."""
        self._target = lambda: endpoint
        for link in self._links:
            with suppress(OSError):  # closed already
                link.shutdown(socket.SHUT_RDWR)

    def finish_request(self, request: Any, client_address: Any) -> None:
        """Relay a connection; when one direction ends, so does the other."""
        port = int(self._target().rpartition(":")[2])
        with suppress(OSError), socket.create_connection(("127.0.0.1", port)) as far:
            self._links.append(request)
            others = {request: far, far: request}
            for end in others:
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while True:
                for source in select.select(others, (), ())[0]:
                    if not (data := source.recv(65536)):
                        return
                    others[source].sendall(data)


def compare(study: Study, out: Path | None = None, *, console: Console | None = None) -> tuple[Path, ResultTables]:
    """Play each run at each security level in real time, with the study's attempts; returns the folder and the tables.

    All runs are resolved and validated before the first one starts. study.json exists from the start, with a status,
    and gets rows as soon as they are known; attempts.md and attempts.csv are written at the end. Raises RunError if a
    run ends before the outsider has finished, and HandlerFailed if the code of an attempt fails.
    """
    console = console or Console(quiet=True)
    options: Any = {"seed": study.seed, "frames": study.frames, "mode": "realtime"}
    resolved: dict[str, Resolved] = {}
    for each in study.configurations:
        file, loaded = scenario.load(each.scenario, (*study.scenes[0].settings, *each.settings))
        resolved[each.label] = scenario.resolve(file, loaded | {"name": each.label}, **options)
    folder, rows = new_folder(out, study.name), list[dict[str, Any]]()
    status_file = folder / "study.json"

    def write_status(status: str) -> None:
        content = {"name": study.name, "status": status, "security": list(study.security), "rows": rows}
        run_folder.write_json(status_file, content)

    with status_written(status_file, write_status, f"results so far are in {status_file}"):
        for label, level in itertools.product(resolved, study.security):
            console.print(f"[dim]{label} at {level}: {len(study.attempts)} attempts of an outsider")
            outcomes = attack(resolved[label], folder / f"{label}-{level}", level, study.attempts)
            for name, outcome in outcomes.items():
                row = {"run": label, "level": level, "attempt": name, **asdict(outcome)}
                rows.append(row | {"succeeded": outcome.succeeded})
    tables = tables_of(rows)
    for name, content in zip(FILES, (tables.as_markdown(), tables.as_csv()), strict=True):
        (folder / name).write_text(content, encoding="utf-8")
    return folder, tables


def attack(resolved: Resolved, folder: Path, level: str, attempts: Sequence[Attempt]) -> dict[str, Outcome]:
    """Make attempts in one run; what each achieved, by name.

    The last one, STRAY, counts other messages from outside the run that reached a host. Errors in the code of an
    attempt become HandlerFailed, with the line.
    """
    outcomes: dict[str, Outcome] = {}
    with AttackedRun(resolved, folder, level, {each.lures for each in attempts if each.lures}) as attacked_run:
        for attempt in attempts:
            try:
                outcomes[attempt.name] = attempt.act(attacked_run, attempt)
            except (MastError, zenoh.ZError):
                raise
            except Exception as error:
                where = failures.location(error, attempt.act)
                problem = f"the attacker {attempt.name!r} failed: {described(error)} ({where})"
                raise HandlerFailed(problem) from error
        reached = attacked_run.foreign_messages()
    for attempt in attempts:
        outcomes[attempt.name].reached = reached.pop(attempt.wire, 0)
    return outcomes | {STRAY: Outcome(reached=reached.total())}


def tables_of(rows: Sequence[Mapping[str, Any]]) -> ResultTables:
    """A table for each run, with a line for each attempt and a column for each level; and all counts."""
    levels, tables = list(dict.fromkeys(row["level"] for row in rows)), []
    for run_ in dict.fromkeys(row["run"] for row in rows):
        lines: dict[str, list[str]] = {}
        for row in rows:
            if row["run"] == run_:
                lines.setdefault(row["attempt"], [row["attempt"]]).append(_verdict(row))
        tables.append(TextTable(run_, CAPTION, ["attempt", *levels], list(lines.values()), 1 + len(levels)))
    brief = [
        table._replace(lines=[[cell.replace(" (", "\n(") for cell in line] for line in table.lines]) for table in tables
    ]
    counts = [[int(cell) if isinstance(cell, bool) else cell for cell in row.values()] for row in rows]
    return ResultTables("Attempts at each security level", ABOUT, "", tables, (list(rows[0]), counts), brief)


def _verdict(row: Mapping[str, Any]) -> str:
    """What an attempt achieved at one level, in words and counts."""
    stray = row["attempt"] == STRAY
    counts = []
    if row["expected"] or stray:
        counts.append(f"in {row['reached']}" + (f"/{row['expected']}" if row["expected"] else ""))
    if row["heard"] or not (row["expected"] or stray):
        counts.append(f"out {row['heard']}")
    if row["lured"]:
        counts.append(f"lured {row['lured']}")
    failed = "none" if stray else "no effect" if row["admitted"] else "refused"
    return f"{'succeeds' if row['succeeded'] else failed} ({', '.join(counts)})"
