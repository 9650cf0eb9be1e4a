"""How a running run is reached and observed: its router, its scenario, its wiring and its scene."""

from __future__ import annotations

import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from mast_zenoh import run_folder
from mast_zenoh.config.loading import OWN_RUN, SHIPPED, AllowedCode
from mast_zenoh.config.resolved import RECORDING, Resolved
from mast_zenoh.errors import ConfigurationError, MessageError, NotRunning, SceneError, UntrustedCode
from mast_zenoh.launch import liveness, measurement
from mast_zenoh.launch.context import VIEWER_CREDENTIALS
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.launch.liveness import check_from_here
from mast_zenoh.mesh.control import codec, prefix
from mast_zenoh.mesh.control.codec import Name, Roles
from mast_zenoh.mesh.control.files import DESCRIBE, WITHOUT_SCENE, Description, decode_description
from mast_zenoh.mesh.control.flow import wiring_of
from mast_zenoh.messages import user_types
from mast_zenoh.run_folder import read_json
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.wiring.model import Wiring

_ANSWER_S = 3.0
_CONNECT_S = 3.0


@dataclass(frozen=True, eq=False)
class LiveAddress:
    """How a running run is reached, and what it began with.

    id:       of the run;  endpoint: of its router;  credentials: folder of the viewer's, None on an open mesh
    resolved: its scenario, with the wiring it began with;  scene: None: not prepared, or not known
    folder:   None: not on this machine;  refused: which of the user's modules were not loaded, and why; "": none
    """

    id: str
    endpoint: str
    resolved: Resolved
    scene: Recording | None
    credentials: Path | None = None
    folder: Path | None = None
    refused: str = ""

    @classmethod
    def of_folder(cls, path: Path, allowed: AllowedCode = SHIPPED) -> LiveAddress:
        """The run that is going on in a folder; loads those of its scenario's modules that are allowed.

        Raises NotRunning if it is not running on a mesh, or not yet, or if it is secure and was started without
        a viewer; UntrustedCode if it was not started on this machine; RunFolderError for other folders.
        """
        record = liveness.current_record(read_json(path / "run.json"))
        if record.get("status") != RUNNING:
            raise NotRunning(f"{path}: the run is over: {record.get('status')}")
        if record.get("runtime") != "mesh":
            raise NotRunning(f"{path}: the run is in one process: expected a run on a mesh, or a finished run")
        if not record.get("endpoint"):
            raise NotRunning(f"{path}: the run has not started its nodes yet")
        check_from_here(path, record, allowed, f"the router {record.get('endpoint')}")
        if liveness.is_own(path / "run.json", record):
            allowed = OWN_RUN  # this user runs the same code already
        credentials = None
        if record.get("security", "open") != "open":
            if not record.get(VIEWER_CREDENTIALS):
                raise NotRunning(
                    f"{path}: security level {record['security']}: the run has no certificate for a viewer: start it "
                    "with --view"
                )
            credentials = Path(record[VIEWER_CREDENTIALS])
        resolved = measurement.scenario_of(path, allowed)
        user_types.use(resolved.messages)
        refused = ""
        try:
            resolved.load_modules()
        except UntrustedCode as error:  # frames are measured with shipped classes
            refused = str(error)
        scene = Recording.load(path / RECORDING) if (path / RECORDING).is_file() else None
        return cls(str(record["id"]), str(record["endpoint"]), resolved, scene, credentials, path, refused)

    @classmethod
    def of_mesh(cls, session: zenoh.Session, endpoint: str, run: str = "") -> LiveAddress:
        """The run that is going on on a mesh. No Python file that its scenario names is imported.

        run: its id, needed if there are several
        Raises NotRunning if none answers, ConfigurationError if several do, or none with this id.
        """
        runs: dict[str, Description] = {}
        for each in _descriptions(session, f"{prefix(run or '*')}/{DESCRIBE}"):
            runs.setdefault(each.run, each)
        if not runs:
            which = f"run {run!r}" if run else "run"
            raise NotRunning(f"{endpoint}: no {which} answers: expected the router of a running run (mast run --help)")
        if len(runs) > 1:
            raise ConfigurationError(f"{endpoint}: several runs: expected --run with one of {', '.join(sorted(runs))}")
        (description,) = runs.values()
        try:
            resolved = Resolved.from_json(description.scenario, description.wiring).allowing(SHIPPED, endpoint)
            user_types.use(resolved.messages)
            wiring_of(description.wiring, DESCRIBE)
        except (KeyError, TypeError, ValueError, AttributeError, MessageError) as error:
            raise NotRunning(f"{endpoint}: the run describes itself in a way that cannot be read: {error!r}") from None
        return cls(description.run, endpoint, resolved, _scene(description.scene, endpoint))

    @property
    def roles(self) -> dict[str, str]:
        """The roles of the nodes that it began with, by name."""
        return {name: spec.role for name, spec in self.resolved.nodes.items()}

    def current_wiring(self, session: zenoh.Session) -> tuple[Wiring, dict[str, str]] | None:
        """The wiring now, and the roles of all nodes, also of those inserted live; None: the run does not answer.

        The wiring of a secure run does not change.
        """
        if self.credentials is not None:
            return Wiring.from_json(self.resolved.wiring), self.roles
        for description in _descriptions(session, f"{prefix(self.id)}/{DESCRIBE}", WITHOUT_SCENE):
            with suppress(MessageError):
                nodes = codec.converted(description.scenario.get("nodes"), dict[Name, dict[str, Any]], DESCRIBE)
                roles = codec.converted({name: spec.get("role") for name, spec in nodes.items()}, Roles, DESCRIBE)
                return wiring_of(description.wiring, DESCRIBE), roles
        return None

    def is_over(self, session: zenoh.Session) -> bool:
        """Whether the run has ended."""
        if self.folder is not None:
            record = liveness.current_record(run_folder.json_or_empty(self.folder / "run.json"))
            return record.get("status") != RUNNING
        return not any(_descriptions(session, f"{prefix(self.id)}/{DESCRIBE}", WITHOUT_SCENE))


def is_starting(path: Path) -> bool:
    """Whether the run in a folder has not started its nodes yet, and may do so soon."""
    record = liveness.current_record(run_folder.json_or_empty(path / "run.json"))
    return record.get("status") == RUNNING and record.get("runtime") == "mesh" and not record.get("endpoint")


def await_start(folder: Path, timeout_s: float, stop: threading.Event, allowed: AllowedCode = SHIPPED) -> LiveAddress:
    """The run of a folder, once it has started its nodes; raises NotRunning if it does not, or cannot be observed.

    allowed: which of the code that it names may run
    """
    deadline = time.monotonic() + timeout_s
    while is_starting(folder) and time.monotonic() < deadline and not stop.is_set():
        stop.wait(0.1)
    return LiveAddress.of_folder(folder, allowed)


def check_reachable(endpoint: str) -> None:
    """Raise NotRunning unless something listens at an endpoint; a Zenoh client would try for ever.

    Raises ConfigurationError for something else than tcp/HOST:PORT.
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tcp" or not host or not port.isdigit() or not 0 < int(port) < 1 << 16:
        raise ConfigurationError(f"{endpoint!r}: expected the folder of a run, or a router: tcp/HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S).close()
    except OSError as error:
        raise NotRunning(f"{endpoint}: nothing answers ({error.strerror or error})") from None


def _descriptions(session: zenoh.Session, key: str, request: bytes = b"") -> Iterator[Description]:
    """All valid answers to a request for descriptions."""
    options: dict[str, Any] = {"payload": request, "timeout": _ANSWER_S}
    for reply in session.get(key, **options):
        if reply.ok is not None:
            try:
                yield decode_description(reply.ok.payload.to_bytes())
            except MessageError:
                continue


def _scene(content: bytes, endpoint: str) -> Recording | None:
    """The scene in a description; None if it has none."""
    if not content:
        return None
    with tempfile.TemporaryDirectory(prefix="mast-view-") as place:
        path = Path(place) / RECORDING
        path.write_bytes(content)
        try:
            return Recording.load(path)
        except SceneError as error:
            raise NotRunning(f"{endpoint}: the scene that the run sends cannot be read: {error}") from None
