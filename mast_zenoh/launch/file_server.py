"""Serves files to nodes that live elsewhere, and takes theirs: the launcher's end of runtime.file_client.

A node gets scenario.json and wiring.json, the scene if it drives it, and the user's Python files that it is made of:
its own and those that define algorithms, with what they import from beside them. It may give the files that its
own parameters name, and no others.
"""

from __future__ import annotations

import ast
import json
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import zenoh

from mast_zenoh import version
from mast_zenoh.config.resolved import RECORDING, Resolved
from mast_zenoh.control import control_prefix, files
from mast_zenoh.control.failures import described
from mast_zenoh.control.files import PIECE_BYTES
from mast_zenoh.control.invalid import InvalidMessages
from mast_zenoh.errors import MastError, MessageError, VersionMismatch
from mast_zenoh.runtime.file_client import files_written_by
from mast_zenoh.scenes.recording import Recording

#: Requests of one node that may wait; it sends one at a time, and again after five seconds.
MAX_WAITING = 16

Request = files.Join | files.Clock | files.Piece | files.Written


class FileServer:
    """Serves the files of all nodes of one run, in a thread of its own, until it is closed.

    resolved: returns the scenario as it is run now
    without:  returns the nodes that a node need not wait for
    mismatch: called when a node of another version has been refused
    invalid: counts what is refused
    taken_at: when the last piece of a file was taken, on the monotonic clock
    """

    def __init__(
        self,
        session: zenoh.Session,
        run: str,
        folder: Path,
        resolved: Callable[[], Resolved],
        without: Callable[[str], list[str]],
        mismatch: Callable[[VersionMismatch], None],
        invalid: InvalidMessages,
    ) -> None:
        self.taken_at = float("-inf")
        self._folder = folder
        self._resolved = resolved
        self._without = without
        self._mismatch = mismatch
        self._invalid = invalid
        self._waiting: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._closed = False
        self.death = ""  # the exception that has ended its thread, if one has
        self._kept: dict[str, dict[str, bytes | Path]] = {}
        self._asked: queue.SimpleQueue[tuple[zenoh.Query, Request, int] | None] = queue.SimpleQueue()
        handler: Any = zenoh.handlers.Callback(self._on_query, indirect=False)
        base = control_prefix(run)
        self._declared = [session.declare_queryable(f"{base}/{what}/*", handler) for what in ("fetch", "file")]
        self._thread = threading.Thread(target=self._live, name="file-server")
        self._thread.start()

    @property
    def died(self) -> bool:
        """Whether its thread has ended before it was closed."""
        return not self._closed and not self._thread.is_alive()

    def close(self) -> None:
        """Stop serving."""
        self._closed = True
        for queryable in self._declared:
            queryable.undeclare()
        self._asked.put(None)
        self._thread.join()

    def _live(self) -> None:
        try:
            self._serve()
        except BaseException as error:  # `died` says so to the run
            self.death = described(error)

    def _on_query(self, query: zenoh.Query) -> None:
        """Take up a request, in Zenoh's thread; a malformed one takes no room in the queue."""
        (what, node), came_ns = _asked(query), time.time_ns()
        try:
            if node not in self._resolved().nodes:
                raise MessageError(f"there is no node {node!r:.80} in this run")
            payload = query.payload.to_bytes() if query.payload else b""
            request = files.decode_file(payload) if what == "file" else files.decode_fetch(payload)
            with self._lock:
                if self._waiting[node] >= MAX_WAITING:
                    raise MessageError(f"more than {MAX_WAITING} wait")
                self._waiting[node] += 1
        except MessageError as error:
            self._refuse(query, what, node, error)
        else:
            self._asked.put((query, request, came_ns))

    def _serve(self) -> None:
        while (asked := self._asked.get()) is not None:
            query, request, came_ns = asked
            what, node = _asked(query)
            with self._lock:
                self._waiting[node] -= 1
            try:
                if isinstance(request, files.Written):
                    answer = self._take(node, request)
                else:
                    answer = self._give(node, request, came_ns)
                query.reply(query.key_expr, files.encode(answer))
                query.drop()
            except Exception as error:  # one request never stops the others
                self._refuse(query, what, node, error)
            del asked, query

    def _refuse(self, query: zenoh.Query, what: str, node: str, error: Exception) -> None:
        """Answer with an error; count it, unless it says what a sound node has to know."""
        if not isinstance(error, VersionMismatch):
            self._invalid.note(f"{what}/{node if node in self._resolved().nodes else '*'}", described(error))
        refusal = error if isinstance(error, MastError) else MessageError(described(error))
        with suppress(Exception):  # the node may have gone
            query.reply_err(files.encode_refusal(refusal))
            query.drop()

    def _give(self, node: str, request: files.Join | files.Clock | files.Piece, came_ns: int) -> dict[str, Any]:
        if isinstance(request, files.Clock):
            return {"now_ns": came_ns}
        if isinstance(request, files.Join):
            return self._let_in(node, request)
        content = self._kept.get(node, {}).get(request.path)
        if content is None:
            raise MessageError(f"{node} has no file {request.path!r:.80} to get")
        if isinstance(content, bytes):
            return {"piece": content[request.offset : request.offset + PIECE_BYTES]}
        with content.open("rb") as file:
            file.seek(request.offset)
            return {"piece": file.read(PIECE_BYTES)}

    def _let_in(self, node: str, request: files.Join) -> dict[str, Any]:
        ours, theirs = version.version_string(), request.version
        if theirs != ours:
            error = VersionMismatch(f"{node} runs mast-zenoh {theirs}, the launcher {ours}: install the same on both")
            self._mismatch(error)
            raise error
        resolved = self._resolved()
        self._kept[node] = kept = dict(files_for_node(resolved, node, self._folder))
        sizes = {path: len(c) if isinstance(c, bytes) else c.stat().st_size for path, c in kept.items()}
        written = [path for path in files_written_by(resolved, node) if (self._folder / path).exists()]
        return {"files": sizes, "without": self._without(node), "written": written}

    def _take(self, node: str, written: files.Written) -> dict[str, Any]:
        path, offset, piece = written
        if path not in files_written_by(self._resolved(), node):
            raise MessageError(f"{node} has no file {path!r:.80} to give")
        target = self._folder / path
        with target.open("r+b" if target.exists() else "xb") as file:
            if offset > file.seek(0, 2):
                raise MessageError(f"{path}: there are {file.tell()} bytes, found a piece that begins at {offset}")
            file.seek(offset)
            file.write(piece)
        self.taken_at = time.monotonic()
        return {}


def _asked(query: zenoh.Query) -> tuple[str, str]:
    """Kind of request and node: the last two chunks of the key."""
    what, node = str(query.key_expr).rsplit("/", 2)[1:]
    return what, node


def files_for_node(resolved: Resolved, node: str, folder: Path) -> Iterator[tuple[str, bytes | Path]]:
    """The files that a node needs: name there, and content or the file here. Paths in them are those of the node."""
    spec = resolved.nodes[node]
    places: dict[Path, str] = {}

    def placed(file: str) -> str:
        path = Path(file)
        return f"{places.setdefault(path.parent, f'files/{len(places)}')}/{path.name}"

    own = [spec.file, *resolved.modules]
    placed_scenario = replace(
        resolved,
        modules=tuple(placed(file) for file in resolved.modules),
        nodes={
            name: replace(other, file=placed(other.file) if name == node else "")
            for name, other in resolved.nodes.items()
        },
    )
    yield "scenario.json", json.dumps(placed_scenario.to_json()).encode()
    yield "wiring.json", json.dumps(resolved.wiring).encode()
    sent: set[Path] = set()
    for file in own:
        for path in sorted(with_neighbours(Path(file)) - sent):
            sent.add(path)
            root = next(parent for parent in path.parents if parent in places)
            yield f"{places[root]}/{path.relative_to(root).as_posix()}", path.read_bytes()
    if any(isinstance(value, Recording) for value in spec.config.values()):
        yield RECORDING, folder / RECORDING


def with_neighbours(file: Path) -> set[Path]:
    """A Python file, and all files and packages beside it that it imports by name, and those import."""
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        path = waiting.pop()
        if path in found:
            continue
        found.add(path)
        for name in _imported(path):
            beside, package = file.parent / f"{name}.py", file.parent / name
            if beside.is_file():
                waiting.append(beside)
            elif (package / "__init__.py").is_file():
                waiting += package.rglob("*.py")
    return found


def _imported(path: Path) -> set[str]:
    """First names of the modules that a file imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names
