"""Exchanges files with nodes that live elsewhere; see runtime.file_client.

A node gets scenario.json and wiring.json, the scene if the node drives it, and the user's Python files that it needs:
its own and those that define algorithms, with the modules next to them that they import. It may send back only the
files that its own parameters name.
"""

from __future__ import annotations

import json
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

import zenoh

from mast_zenoh import version
from mast_zenoh.config.resolved import RECORDING, Resolved
from mast_zenoh.errors import MastError, MessageError, VersionMismatch
from mast_zenoh.launch.context import RunContext
from mast_zenoh.mesh.control import codec, control_prefix, files
from mast_zenoh.mesh.control.failures import described
from mast_zenoh.mesh.control.files import PIECE_BYTES
from mast_zenoh.mesh.control.key_marks import check_control_mark
from mast_zenoh.mesh.file_client import files_written_by
from mast_zenoh.mesh.session import direct
from mast_zenoh.scenes.recording import Recording

#: Requests of one node in the queue; it sends one at a time, and repeats it after five seconds.
MAX_WAITING = 16

Request = files.FilesRequest | files.Clock | files.Piece | files.Written


class FileServer:
    """Serves the files of all nodes of one run, in its own thread, until it is closed.

    context: its refused requests are counted, and a node of another version is noted as the run's error
    started: whether a node is to run now; one that asks before gets no files, and asks again
    last_received_s: by node, when the last piece of a file was received, on the monotonic clock
    """

    def __init__(
        self, session: zenoh.Session, context: RunContext, started: Callable[[str], bool] = lambda node: True
    ) -> None:
        self.last_received_s: dict[str, float] = {}
        self._folder = context.folder
        self._resolved = context.resolved_for
        self._started = started
        self._mismatch = context.stop.note
        self._invalid = context.invalid
        self._waiting: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._closed = False
        self.fatal_error = ""  # the exception that ended its thread, if any
        self._contents: dict[str, dict[str, bytes | Path]] = {}
        self._requests: queue.SimpleQueue[tuple[zenoh.Query, Request, int] | None] = queue.SimpleQueue()
        base, handler = control_prefix(context.run_id), direct(self._on_query)
        self._declared = [session.declare_queryable(f"{base}/{kind}/*", handler) for kind in ("fetch", "file")]
        self._thread = threading.Thread(target=self._run, name="file-server")
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
        self._requests.put(None)
        self._thread.join()

    def _run(self) -> None:
        try:
            self._serve()
        except BaseException as error:  # the run reads `died`
            self.fatal_error = described(error)

    def _on_query(self, query: zenoh.Query) -> None:
        """Queue a request, in Zenoh's thread; refuse a malformed one."""
        (kind, node), received_ns = _kind_and_node(query), time.monotonic_ns()
        try:
            if node not in self._resolved(node).nodes:
                raise MessageError(f"there is no node {node!r:.80} in this run")
            check_control_mark(query.key_expr, query.attachment)
            payload = query.payload.to_bytes() if query.payload else b""
            request = files.decode_file(payload) if kind == "file" else files.decode_fetch(payload)
            with self._lock:
                if self._waiting[node] >= MAX_WAITING:
                    raise MessageError(f"more than {MAX_WAITING} requests are waiting")
                self._waiting[node] += 1
        except MessageError as error:
            self._refuse(query, kind, node, error)
        else:
            self._requests.put((query, request, received_ns))

    def _serve(self) -> None:
        while (item := self._requests.get()) is not None:
            query, request, received_ns = item
            kind, node = _kind_and_node(query)
            with self._lock:
                self._waiting[node] -= 1
            try:
                if isinstance(request, files.Written):
                    answer = self._receive(node, request)
                else:
                    answer = self._answer(node, request, received_ns)
                query.reply(query.key_expr, codec.encode(answer))
                query.drop()
            except Exception as error:  # one request never stops the others
                self._refuse(query, kind, node, error)
            del item, query

    def _refuse(self, query: zenoh.Query, kind: str, node: str, error: Exception) -> None:
        """Answer with an error; count it, unless the node is of another version."""
        if not isinstance(error, VersionMismatch):
            self._invalid.note(f"{kind}/{node if node in self._resolved(node).nodes else '*'}", described(error))
        refusal = error if isinstance(error, MastError) else MessageError(described(error))
        with suppress(Exception):  # the node may have gone
            query.reply_err(files.encode_refusal(refusal))
            query.drop()

    def _answer(
        self, node: str, request: files.FilesRequest | files.Clock | files.Piece, received_ns: int
    ) -> dict[str, Any]:
        if isinstance(request, files.Clock):
            return {"now_ns": received_ns}
        if isinstance(request, files.FilesRequest):
            return self._admit(node, request)
        content = self._contents.get(node, {}).get(request.path)
        if content is None:
            raise MessageError(f"{node} has no file {request.path!r:.80} to fetch")
        if isinstance(content, bytes):
            return {"piece": content[request.offset : request.offset + PIECE_BYTES]}
        with content.open("rb") as file:
            file.seek(request.offset)
            return {"piece": file.read(PIECE_BYTES)}

    def _admit(self, node: str, request: files.FilesRequest) -> dict[str, Any]:
        own_version, node_version = version.version_string(), request.version
        if node_version != own_version:
            error = VersionMismatch(
                f"{node} runs mast-zenoh {node_version}, the launcher {own_version}: install the same on both"
            )
            self._mismatch(error)
            raise error
        if not self._started(node):
            return {"files": {}, "written": []}
        resolved = self._resolved(node)
        self._contents[node] = contents = dict(files_for_node(resolved, node, self._folder))
        sizes = {
            path: len(content) if isinstance(content, bytes) else content.stat().st_size
            for path, content in contents.items()
        }
        written = [path for path in files_written_by(resolved, node) if (self._folder / path).exists()]
        return {"files": sizes, "written": written}

    def _receive(self, node: str, written: files.Written) -> dict[str, Any]:
        path, offset, piece = written.path, written.offset, written.piece
        if path not in files_written_by(self._resolved(node), node):
            raise MessageError(f"{node} has no file {path!r:.80} to send")
        target = self._folder / path
        with target.open("r+b" if target.exists() else "xb") as file:
            if offset > file.seek(0, 2):
                raise MessageError(f"{path}: has {file.tell()} bytes, found a piece that begins at {offset}")
            file.seek(offset)
            file.write(piece)
        self.last_received_s[node] = time.monotonic()
        return {}


def _kind_and_node(query: zenoh.Query) -> tuple[str, str]:
    """Kind of a request, and its node: the last two chunks of the key."""
    kind, node = str(query.key_expr).rsplit("/", 2)[1:]
    return kind, node


def files_for_node(resolved: Resolved, node: str, folder: Path) -> Iterator[tuple[str, bytes | Path]]:
    """The files that a node needs: (name there, content or the file here).

    Paths inside scenario.json refer to the node's host.
    """
    spec = resolved.nodes[node]
    folders: dict[Path, str] = {}

    def relocated(file: str) -> str:
        path = Path(file)
        return f"{folders.setdefault(path.parent, f'files/{len(folders)}')}/{path.name}"

    def with_builders(value: Any) -> Any:
        """A configuration with the relocated files of its builders, FILE.py:FUNCTION."""
        if isinstance(value, Mapping):
            return {key: with_builders(item) for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [with_builders(item) for item in value]
        file, colon, function = value.rpartition(":") if isinstance(value, str) else ("", "", "")
        return f"{relocated(file)}{colon}{function}" if file in resolved.modules else value

    sources = [spec.file, *resolved.modules]
    modules = tuple(relocated(file) for file in resolved.modules)
    nodes = {name: replace(each, file="", config=with_builders(each.config)) for name, each in resolved.nodes.items()}
    nodes[node] = replace(nodes[node], file=relocated(spec.file))
    yield "scenario.json", json.dumps(replace(resolved, modules=modules, nodes=nodes).to_json()).encode()
    yield "wiring.json", json.dumps(resolved.wiring).encode()
    sent: set[Path] = set()
    for file in sources:
        for path in sorted(with_local_imports(Path(file)) - sent):
            sent.add(path)
            root = next(parent for parent in path.parents if parent in folders)
            yield f"{folders[root]}/{path.relative_to(root).as_posix()}", path.read_bytes()
    if any(isinstance(value, Recording) for value in spec.config.values()):
        yield RECORDING, folder / RECORDING


def with_local_imports(file: Path) -> set[Path]:
    """A Python file and, recursively, files and packages next to it that it imports."""
    finder = ModuleFinder([str(file.parent)])
    finder.run_script(str(file))
    local = [Path(name) for module in finder.modules.values() if (name := vars(module)["__file__"])]
    packages = [path.parent for path in local if path.name == "__init__.py"]
    return {file, *local, *(path for package in packages for path in package.rglob("*.py"))}
