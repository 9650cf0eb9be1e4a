"""Processes that observe a running run, such as viewers: they begin with a run or later, and end with their parent."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mast_zenoh.cli.options import out as _out
from mast_zenoh.cli.options import refuse
from mast_zenoh.errors import RunFolderError, UntrustedCode

if TYPE_CHECKING:
    import zenoh

    from mast_zenoh.config.loading import AllowedCode
    from mast_zenoh.runs.live.address import LiveAddress

_START_S = 60.0  # for a run to start its nodes
_END_S = 5.0  # for an observer to end
_DYING_S = 2.0  # for a killed launcher to be gone
_PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws")
#: What an observer prints last when it is ready.
LAST_LINE = "Ctrl-C ends it."


class Target(NamedTuple):
    """What is to be observed or played.

    name:    the folder of a run, or the endpoint of a router;  remote: whether it is a router
    record:  run.json; {}: of a router
    running: whether the run is in progress
    """

    name: str
    remote: bool
    record: dict[str, Any]
    running: bool

    @property
    def folder(self) -> Path:
        """The folder of the run."""
        return Path(self.name)


def target_of(name: str, run: str) -> Target:
    """What the target of a command is. run: the value of --run

    Raises RunFolderError for a folder that is none of a run.
    """
    folder, remote = Path(name), is_router(name)
    record = {} if remote else record_of(folder)
    if not remote and folder.is_dir() and not record:
        raise RunFolderError(f"{folder}: found no run.json: the run has not begun, or this is not the folder of a run")
    refuse(run and not remote, f"found {name}, expected a router, such as tcp/HOST:7447, for --run")
    return Target(name, remote, record, remote or record.get("status") == "running")


def is_router(name: str) -> bool:
    """Whether a target is the address of a router, and not a folder."""
    return "/" in name and name.partition("/")[0] in _PROTOCOLS and not Path(name).exists()


def record_of(folder: Path) -> dict[str, Any]:
    """run.json of a run as of now; {}: there is none. Raises RunFolderError for one that cannot be read."""
    from mast_zenoh.launch import liveness
    from mast_zenoh.run_folder import read_object

    if not (folder / "run.json").exists():
        return {}
    return liveness.current_record(read_object(folder / "run.json"))


def print_line(line: str) -> None:
    """Print a line at once, also into a pipe."""
    _out().print(line, markup=False, highlight=False, soft_wrap=True)
    sys.stdout.flush()


# -- in the process that starts it -------------------------------------------------------------------------------------


def observe_apart(command: str, target: Target, allowed: AllowedCode, options: Sequence[str]) -> int:
    """Run a command that observes a running run as a process of its own, to its end or Ctrl-C; returns its exit code.

    allowed: what the caller has confirmed;  options: of the command

    Raises UntrustedCode for a run that was not started on this machine.
    """
    if not target.remote:
        from mast_zenoh.launch.liveness import check_from_here

        check_from_here(target.folder, target.record, allowed, f"the router {target.record.get('endpoint')}")
    return wait(start(command, target.name, *options))


def start(command: str, target: str, *options: str, stdout: int | None = None) -> subprocess.Popen[bytes]:
    """Start a command that observes a running run.

    It has a session of its own: signals of the terminal are for its parent, and its processor time is shared out apart
    from the run's. It ends when its standard input does, so also with its parent.
    """
    words = [sys.executable, "-P", "-m", "mast_zenoh", command, target, "--attached", *options]
    return subprocess.Popen(words, stdin=subprocess.PIPE, stdout=stdout, start_new_session=True)


def wait(child: subprocess.Popen[bytes]) -> int:
    """Wait for an observer, or for Ctrl-C, which ends it; returns its exit code."""
    try:
        return child.wait()
    except KeyboardInterrupt:
        end(child)
        return 0


def end(child: subprocess.Popen[bytes], within_s: float = _END_S) -> None:
    """Have an observer end; kill it if it does not in time, s, or at Ctrl-C."""
    from mast_zenoh.launch.processes import end_process

    assert child.stdin is not None
    with suppress(BrokenPipeError):
        child.stdin.close()
    end_process(child, within_s)


# -- in the process itself ---------------------------------------------------------------------------------------------


def join(
    stack: ExitStack,
    target: str,
    run: str,
    allowed: AllowedCode,
    prepare: Callable[[str], None] = lambda title: None,
) -> tuple[LiveAddress, zenoh.Session, threading.Event]:
    """Join the mesh of a running run to observe it; returns also what is set when the process is to end.

    stack:   leaves at its end
    target:  the folder of a run, or a router with a run of the id `run`, "": its only one
    allowed: which of the code that the run folder names may run
    prepare: called with the title of the run before it is waited for
    """
    from mast_zenoh.mesh import hosting
    from mast_zenoh.runs.live import address
    from mast_zenoh.runs.live.measurement import evaluator_class

    evaluator_class()  # before the run begins
    remote, folder = is_router(target), Path(target)
    stop = stack.enter_context(_stopped(lambda: None if remote else _delete_keys_of_the_dead(folder)))
    if remote:
        address.check_reachable(target)
        session = stack.enter_context(hosting.join(target, None, observer=True))
        running = address.LiveAddress.of_mesh(session, target, run)
        prepare(running.resolved.name)
        return running, session, stop
    prepare(str(record_of(folder).get("name") or target))
    running = address.await_start(folder, _START_S, stop, allowed)
    if running.refused:
        print_line(f"warning: {running.refused}")
    session = stack.enter_context(hosting.join(running.endpoint, running.credentials, observer=True))
    return running, session, stop


def _delete_keys_of_the_dead(folder: Path) -> None:
    """Delete the credentials of observers if the launcher, which else does so, was killed."""
    from mast_zenoh.config.loading import SHIPPED
    from mast_zenoh.launch import liveness
    from mast_zenoh.launch.context import VIEWER_CREDENTIALS
    from mast_zenoh.mesh.security.credentials import VIEWER
    from mast_zenoh.mesh.security.deployment import KEYS

    try:
        liveness.check_from_here(folder, record_of(folder), SHIPPED, "a folder of keys")
    except UntrustedCode:
        return
    credentials = Path(str(record_of(folder).get(VIEWER_CREDENTIALS, "")))
    if credentials.name != VIEWER or not credentials.parent.name.startswith(KEYS):  # a file may say anything
        return
    # A process that dies closes its pipes a moment before it is gone.
    deadline = time.monotonic() + _DYING_S
    while (running := record_of(folder).get("status") == "running") and time.monotonic() < deadline:
        threading.Event().wait(0.05)
    if not running:
        shutil.rmtree(credentials, ignore_errors=True)
        with suppress(OSError):
            credentials.parent.rmdir()


@contextmanager
def _stopped(clean_up: Callable[[], None]) -> Iterator[threading.Event]:
    """An event that is set by SIGTERM and by the end of standard input, soon after which the process ends.

    clean_up: called at the end, in any case
    """
    stop = threading.Event()
    before = signal.signal(signal.SIGTERM, lambda *_: stop.set())

    def follow_input() -> None:
        # Not through sys.stdin: a thread that waits for its lock makes the interpreter crash when it exits.
        with suppress(OSError):
            while os.read(0, 4096):
                pass
        stop.set()
        threading.Event().wait(_END_S - 1.0)  # what waits for the mesh may not look at `stop`
        clean_up()
        os._exit(0)

    threading.Thread(target=follow_input, daemon=True).start()
    try:
        yield stop
    finally:
        signal.signal(signal.SIGTERM, before)
        clean_up()
