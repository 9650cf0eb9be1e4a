"""A run with compromised nodes in its own process, and its outcome.

Tests call `play`, which starts that process and acts as the insiders: each is a second session with the certificate of
a node that is itself honest. The driver holds the run before a frame until every insider has sent its messages.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import failing
import zenoh
from insider.position import MARKER
from launched import eventually
from launched_apart import Beside
from rich.console import Console

from mast_zenoh import scenario
from mast_zenoh.cli.options import reporting
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MastError
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.context import RunContext
from mast_zenoh.mesh.control import prefix
from mast_zenoh.mesh.protocol.driver import DriverProtocol, DriverState, Phase
from mast_zenoh.mesh.security.credentials import Credentials
from mast_zenoh.mesh.security.levels import client_settings
from mast_zenoh.mesh.session import open_session
from mast_zenoh.show import html

#: The actions of an insider in its session; the second argument is the prefix of all keys of the run.
Insider = Callable[[zenoh.Session, str], object]

FRAMES, HELD_BEFORE = 8, 4
_XDG = ("CACHE", "CONFIG")

SCENARIO = """
from mast_zenoh.config import loading

_, network = loading.function("scenarios", "realistic_network", "scenario")


def scenario():
    made = network(attack="coordinated", n_adversaries=1, n_infrastructure=1, n_mobile=0)
    rewrites = [*made["keyexpr"]["rewrites"], {"listen": [dict(wire="clock", role="visualizer", input="clock")]}]
    counter = dict(role="visualizer", file="counter.py")
    return made | dict(name="insiders", nodes=dict(counter=counter), keyexpr=made["keyexpr"] | dict(rewrites=rewrites))
"""

#: One node of every role except the driver; the last is user-defined.
NODES = (
    *("infra_1", "broker", "command_center", "adversary_1", "coordinator", "link_ego", "evaluator", "recorder"),
    "counter",
)


def resolved(folder: Path) -> Resolved:
    """Describe the run: all roles, recorded, lock-step; folder: of the scenario."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "insiders.py").write_text(SCENARIO)
    (folder / "counter.py").write_text(failing.FILES["second"]["counter.py"])
    return scenario.resolve(*scenario.load(str(folder / "insiders.py")), frames=FRAMES, record=True)


@dataclass
class RunOutcome:
    """Exit code, console, run.json, peak memory by process in MiB, and stray files."""

    code: int
    console: str
    folder: Path
    record: dict[str, Any]
    peaks_mib: dict[str, float]
    strays: list[str]

    @property
    def message(self) -> str:
        """The error of the run."""
        return str(self.record["message"])

    def refused(self) -> dict[str, int]:
        """Refused control messages by key."""
        nodes = self.record["nodes"].values()
        parts = [self.record["invalid_control"], *(node["invalid_control"] or {} for node in nodes)]
        return {key: count for part in parts for key, (count, _) in part.items()}

    def sound(self) -> None:
        """Assert that nothing was written elsewhere, no traceback, bounded memory."""
        assert self.strays == []
        texts = {path.name: path.read_text(errors="replace") for path in (self.folder / "logs").iterdir()}
        for name, text in {"console": self.console, **texts}.items():
            assert "Traceback" not in text, f"{name}:\n{text[-3000:]}"
        assert {name: mib for name, mib in self.peaks_mib.items() if mib > 400} == {}


def play(
    folder: Path,
    insiders: Mapping[str, Insider],
    again: Mapping[str, Insider] | None = None,
    seconds: float = 150.0,
) -> RunOutcome:
    """Run it in a process with new home, working and temporary folders.

    insiders: by compromised node its action while the run is held
    again:    its action repeated until the run ends
    """
    places = {name: folder / name for name in ("home", "work", "tmp")}
    for place in places.values():
        place.mkdir(parents=True)
    own = [str(Path(__file__).parent), str(Path(failing.__file__).parent)]
    beside = [*own, *filter(None, [os.environ.get("PYTHONPATH")])]
    paths = {"HOME": places["home"], "TMPDIR": places["tmp"], **{f"XDG_{x}_HOME": folder / x for x in _XDG}}
    with (folder / "console").open("wb") as console:
        process = subprocess.Popen(
            [sys.executable, __file__, str(folder)],
            stdout=console,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            cwd=places["work"],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(beside), **{name: str(at) for name, at in paths.items()}},
        )
    try:
        _be_the_insiders(process, folder, insiders, again or {})
        code = process.wait(seconds)
    except BaseException:
        process.kill()
        process.wait()
        raise
    strays = [str(path) for place in places.values() for path in place.iterdir()]
    strays += [str(path) for place in (folder, *folder.parents) for path in place.glob(f"*{MARKER}*")]
    strays += [str(path) for path in Path("/tmp").glob(f"*{MARKER}*")]
    text = (folder / "console").read_text(errors="replace")
    assert (folder / "peaks").is_file(), text
    record, peaks = (json.loads(path.read_text()) for path in (folder / "run/run.json", folder / "peaks"))
    return RunOutcome(code, text, folder / "run", record, peaks, strays)


def _be_the_insiders(
    process: subprocess.Popen[bytes],
    folder: Path,
    insiders: Mapping[str, Insider],
    again: Mapping[str, Insider],
) -> None:
    """Join with the certificate of each node and send; then let the run continue."""
    eventually(lambda: (folder / "ready").is_file() or process.poll() is not None, "the driver holds the run")
    assert process.poll() is None, (folder / "console").read_text()
    ready = json.loads((folder / "ready").read_text())

    def be(node: str) -> None:
        own = Credentials.read(Path(ready["keys"]) / node)
        settings = {"mode": "client", "connect/endpoints": [ready["endpoint"]], "connect/timeout_ms": 10_000}
        with suppress(zenoh.ZError), open_session(settings | client_settings(own)) as session:
            if node in insiders:
                insiders[node](session, ready["prefix"])
            while node in again and not over.wait(0.02):  # no flood: docs/explanation-security.md covers floods
                again[node](session, ready["prefix"])
                (folder / "go").touch()

    over = threading.Event()
    threads = [threading.Thread(target=be, args=(node,)) for node in {**insiders, **again}]
    for thread in threads:
        thread.start()
    if not again:
        for thread in threads:
            thread.join()
        (folder / "go").touch()
    process.wait(150.0)
    over.set()
    for thread in threads:
        thread.join()


def hold(frame: int, go: str, stall_timeout_s: float) -> None:
    """Make this process's driver wait before a frame until the file `go` exists.

    stall_timeout_s: its limit for waiting until the mesh is quiet
    """
    carry_out = DriverProtocol._carry_out

    def waiting(self: DriverProtocol) -> Phase:
        while self.frames == frame and not Path(go).exists() and not self._end_reason:
            yield from self._wait(DriverState.PACING, self._now_s + 0.02)
        return (yield from carry_out(self))

    DriverProtocol._carry_out = waiting  # type: ignore[method-assign]
    DriverProtocol.stall_timeout_s = stall_timeout_s


def main(folder: Path) -> None:
    """The process that carries out the run."""
    run, held = resolved(folder / "scenario"), f"hold({HELD_BEFORE}, {str(folder / 'go')!r}, 6.0)"
    driver = next(name for name, spec in run.nodes.items() if spec.role == "simulator")
    here = str(Path(__file__).parent)
    engine = Beside({driver: f"__import__('sys').path.append({here!r}); __import__('compromised_run').{held}"})
    peaks: dict[str, float] = {}
    over = threading.Event()
    watchers: list[threading.Thread] = []

    def prepare(context: RunContext) -> None:
        watchers.append(threading.Thread(target=_watch, args=(context, folder, peaks, over)))
        watchers[0].start()

    try:
        outcome = launcher.run(
            run, folder / "run", secure="acl", engine=engine, prepare=prepare, console=Console(width=400)
        )
    finally:
        over.set()
        for watcher in watchers:
            watcher.join()
    try:
        with reporting(outcome.folder):
            html.write_report(outcome.folder)
    except MastError as error:
        print(f"no report: {error}")
    (folder / "peaks").write_text(json.dumps(peaks))
    if outcome.error is not None:
        sys.exit(outcome.error.exit_code)


def _watch(context: RunContext, folder: Path, peaks: dict[str, float], over: threading.Event) -> None:
    """Report that the run is held, and record the peak memory of each process."""
    while not over.wait(0.05):
        if context.frame >= HELD_BEFORE - 1 and not (folder / "ready").exists():
            access = {
                "keys": str(context.mesh.deployment.folder),
                "endpoint": context.record["endpoint"],
                "prefix": prefix(context.run_id),
            }
            (folder / "ready.part").write_text(json.dumps(access))
            (folder / "ready.part").rename(folder / "ready")
        pids = {"launcher": os.getpid(), **{name: node["pid"] for name, node in dict(context.record["nodes"]).items()}}
        for name, pid in pids.items():
            with suppress(OSError, StopIteration):
                lines = Path(f"/proc/{pid}/status").read_text().splitlines()
                peak = next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))
                peaks[name] = max(peak, peaks.get(name, 0.0))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
