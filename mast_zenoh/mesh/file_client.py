"""Transfers files between a node on another host and the launcher.

A node fetches its files under @control/fetch/{node}, and hands in the files that it writes, while they grow, under
@control/file/{node}; both are queries of MessagePack maps:

    fetch  {do: "join", version, versions}   → {files: {path: bytes}, written: [paths]}, or an error
    fetch  {do: "clock"}                     → {now_ns}
    fetch  {do: "piece", path, offset}       → {piece: bytes}
    file   {path, offset, piece}             → {}
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from pathlib import Path
from typing import Any, TypeVar

import zenoh

from mast_zenoh import version
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MessageError, RunError
from mast_zenoh.mesh.control import codec, control_prefix, files
from mast_zenoh.mesh.control.codec import ControlMessage
from mast_zenoh.mesh.control.files import PIECE_BYTES
from mast_zenoh.mesh.control.key_marks import control_mark
from mast_zenoh.run_folder.recording.writer import MessageLog

_HAND_IN_EVERY_S = 1.0
_HAND_IN_TIMEOUT_S = 20.0
_PROBES = 5
_TURN_S = 0.2  # between two questions whether the scenario has started the node

log = logging.getLogger("mast")

Answer = TypeVar("Answer")


class FileClient:
    """Fetches a node's files from the launcher, and hands in the files that it writes.

    clock: of monotonic clocks: offset_ms, this host's minus the launcher's; round_trip_ms, of that measurement
    """

    def __init__(self, session: zenoh.Session, run: str, name: str) -> None:
        self._session = session
        self._base = control_prefix(run)
        self._name = name
        self.clock: dict[str, float] = {}

    def fetch(self, folder: Path, patience_s: float) -> None:
        """Fetch this node's files into a folder; raises the error with which the launcher refuses."""
        request = files.FilesRequest(version.version_string(), version.versions())
        while not (node_files := self.ask("fetch", request, patience_s, files.NodeFiles)).files:
            threading.Event().wait(_TURN_S)  # the scenario starts this node later
        for path, size in node_files.files.items():
            target = _below(folder, path)
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("wb") as file:
                while file.tell() < size:
                    piece = self.ask("fetch", files.Piece(path, file.tell()), patience_s, files.Content).piece
                    if not piece:
                        raise RunError(f"{path}: the launcher has {file.tell()} bytes of it, expected {size}")
                    file.write(piece)
        for path in node_files.written:
            _below(folder, path).touch()  # a restarted node must not begin such a file again
        self._measure_clock_offset(patience_s)

    def hand_in(self, path: str, offset: int, piece: bytes, seconds: float) -> None:
        """Append to a file of the run folder."""
        self.ask("file", files.Written(path, offset, piece), seconds, files.Nothing)

    def ask(self, what: str, request: ControlMessage, seconds: float, kind: type[Answer]) -> Answer:
        """Query the launcher until it answers; returns the decoded answer, of this kind. An invalid one is ignored.

        Raises the error with which the launcher refuses, and RunError after `seconds` without an answer.
        """
        deadline = time.monotonic() + seconds
        payload, key = codec.encode(request), f"{what}/{self._name}"
        options: Any = {"payload": payload, "attachment": control_mark(key), "timeout": 5.0}
        while True:
            for reply in self._session.get(f"{self._base}/{key}", **options):
                if reply.ok is not None:
                    try:
                        return files.decode_answer(kind, reply.ok.payload.to_bytes())
                    except MessageError as error:
                        log.warning("the launcher's answer (%s) is invalid: %s", what, error)
                if reply.err is not None and (refusal := files.decode_refusal(reply.err.payload.to_bytes())):
                    raise refusal
            if time.monotonic() > deadline:
                raise RunError(f"{self._name}: the launcher has not answered ({what}) within {seconds:.0f} s")
            threading.Event().wait(0.1)

    def _measure_clock_offset(self, seconds: float) -> None:
        """Measure the offset from the launcher's clock as NTP does: the fastest counts."""
        measurements = []
        for _ in range(_PROBES):
            sent_ns = time.monotonic_ns()
            launcher_ns = self.ask("fetch", files.Clock(), seconds, files.LauncherTime).now_ns
            received_ns = time.monotonic_ns()
            measurements.append((received_ns - sent_ns, (sent_ns + received_ns) // 2 - launcher_ns))
        round_trip, offset = min(measurements)
        self.clock = {"offset_ms": round(offset * 1e-6, 3), "round_trip_ms": round(round_trip * 1e-6, 3)}


class HandIn:
    """A context that sends growing files to the launcher."""

    def __init__(self, client: FileClient, folder: Path, paths: tuple[str, ...]) -> None:
        self._client = client
        self._folder = folder
        self._offsets = dict.fromkeys(paths, 0)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)

    def __enter__(self) -> HandIn:
        if self._offsets:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        if self._offsets:
            self._thread.join()

    def finish(self) -> None:
        """Send the rest of the files, which no longer grow; raises RunError if the launcher does not answer."""
        self._closing.set()
        if self._offsets:
            self._thread.join()
            self._send()

    def _follow(self) -> None:
        while not self._closing.wait(_HAND_IN_EVERY_S):
            try:
                self._send()
            except Exception as error:  # `finish` tries again, and raises
                log.warning("files could not be handed in yet: %s", error)

    def _send(self) -> None:
        for path in self._offsets:
            with contextlib.suppress(FileNotFoundError), (self._folder / path).open("rb") as file:
                file.seek(self._offsets[path])
                while piece := file.read(PIECE_BYTES):
                    self._client.hand_in(path, self._offsets[path], piece, _HAND_IN_TIMEOUT_S)
                    self._offsets[path] += len(piece)


def files_written_by(resolved: Resolved, name: str, instance: Any = None) -> tuple[str, ...]:
    """Files that a node writes: the message logs among its parameters and attributes."""
    values = [*resolved.nodes[name].config.values(), *(vars(instance).values() if instance is not None else ())]
    return tuple(dict.fromkeys(str(value.path) for value in values if isinstance(value, MessageLog)))


def _below(folder: Path, path: str) -> Path:
    """A path below a folder; raises RunError for one outside of it."""
    target = (folder / path).resolve()
    if not target.is_relative_to(folder.resolve()):
        raise RunError(f"{path}: leads outside the run folder")
    return target
