"""A run some of whose nodes are compromised, in a process of its own: what becomes of the run and of that process.

`play` is for tests; the rest runs in that process. Each insider is a second session with the certificate of its node,
which itself stays sound. The driver holds the run before a frame until every insider has sent what it has.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh
from launched_apart import Beside
from rich.console import Console

from mast_zenoh import scenario
from mast_zenoh.errors import MastError
from mast_zenoh.resolved import Resolved
from mast_zenoh.study.rogue.forgeries import Forgery
from mast_zenoh.study.rogue.position import MARKER
from mast_zenoh.study.rogue.sending import send
from mast_zenoh.study.rogue.siege import Siege

FRAMES, HELD_BEFORE = 8, 4

SCENARIO = """
from mast_zenoh import loading

_, network = loading.function("scenarios", "realistic_network", "scenario")


def scenario():
    made = network(attack="coordinated", n_adversaries=1, n_infrastructure=1, n_mobile=0)
    rewrites = [*made["keyexpr"]["rewrites"], {"listen": [dict(wire="clock", role="visualizer", input="clock")]}]
    counter = dict(role="visualizer", file="counter.py")
    return made | dict(name="insiders", nodes=dict(counter=counter), keyexpr=made["keyexpr"] | dict(rewrites=rewrites))
"""

#: Of every role but the driver's one node; the last is a user's own.
NODES = (
    *("infra_1", "broker", "command_center", "adversary_1", "coordinator", "link_ego", "evaluator", "recorder"),
    "counter",
)


def resolved(folder: Path) -> Resolved:
    """The run: every role, recorded, in lock-step. folder: of the scenario file that it is read from."""
    import failing

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "insiders.py").write_text(SCENARIO)
    (folder / "counter.py").write_text(failing.FILES["second"]["counter.py"])
    path, loaded = scenario.load(str(folder / "insiders.py"))
    return scenario.resolve(path, loaded, frames=FRAMES, record=True)


@dataclass
class Job:
    """What happens in a run.

    messages:  by compromised node what it sends on control keys while the run is held
    again:     these are sent again and again until the run ends
    """

    folder: Path
    messages: dict[str, list[Forgery]] = field(default_factory=dict)
    again: dict[str, list[Forgery]] = field(default_factory=dict)


@dataclass
class Ended:
    """What has become of it: exit code, console, run.json, MiB at most by process, and files where there were none."""

    code: int
    console: str
    folder: Path
    record: dict[str, Any]
    peaks_mib: dict[str, float]
    strays: list[str]

    @property
    def message(self) -> str:
        """Why it failed."""
        return str(self.record["message"])

    def refused(self) -> dict[str, int]:
        """Control messages that were refused, by key."""
        nodes = self.record["nodes"].values()
        parts = [self.record["invalid_control"], *(node["invalid_control"] or {} for node in nodes)]
        return {key: count for part in parts for key, (count, _) in part.items()}

    def sound(self) -> None:
        """Nothing was written elsewhere, no traceback was printed, and no process has taken too much memory."""
        assert self.strays == []
        texts = {path.name: path.read_text(errors="replace") for path in (self.folder / "logs").iterdir()}
        for name, text in {"console": self.console, **texts}.items():
            assert "Traceback" not in text, f"{name}:\n{text[-3000:]}"
        assert {name: mib for name, mib in self.peaks_mib.items() if mib > 400} == {}


def play(job: Job, seconds: float = 150.0) -> Ended:
    """Play a run in a process of its own, whose home, working directory and temporary directory are new and empty."""
    places = {name: job.folder / name for name in ("home", "work", "tmp")}
    for place in places.values():
        place.mkdir(parents=True)
    (job.folder / "job").write_bytes(pickle.dumps(job))
    beside = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
    ours = {"PYTHONPATH": os.pathsep.join(beside), "HOME": str(places["home"]), "TMPDIR": str(places["tmp"])}
    with (job.folder / "console").open("wb") as console:
        ended = subprocess.run(
            [sys.executable, __file__, str(job.folder)],
            stdout=console,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            timeout=seconds,
            cwd=places["work"],
            env={**os.environ, **ours, "XDG_CACHE_HOME": str(job.folder / "cache")},
        )
    strays = [str(path) for place in places.values() for path in place.iterdir()]
    strays += [str(path) for path in (job.folder, *job.folder.parents) for path in path.glob(f"*{MARKER}*")]
    strays += [str(path) for path in Path("/tmp").glob(f"*{MARKER}*")]
    text = (job.folder / "console").read_text(errors="replace")
    run = job.folder / "run"
    assert (job.folder / "peaks").is_file(), text
    record, peaks = (json.loads(path.read_text()) for path in (run / "run.json", job.folder / "peaks"))
    return Ended(ended.returncode, text, run, record, peaks, strays)


def main() -> None:
    """The process of a run."""
    folder = Path(sys.argv[1])
    job: Job = pickle.loads((folder / "job").read_bytes())
    run, go = resolved(folder / "scenario"), folder / "go"
    driver = next(name for name, spec in run.nodes.items() if spec.role == "simulator")
    hold = f"hold({HELD_BEFORE}, {str(go)!r}, 6.0)"
    here = str(Path(__file__).parent)
    engine = Beside({driver: f"__import__('sys').path.append({here!r}); __import__('compromised').{hold}"})
    peaks: dict[str, float] = {}
    with Siege(run, folder / "run", "acl", engine=engine, console=Console(width=400)) as siege:
        over = threading.Event()
        watcher = threading.Thread(target=_watch, args=(siege, peaks, over))
        watcher.start()
        siege.wait(lambda: siege.launch.frame >= HELD_BEFORE - 1, 60.0, "the driver holds the run")
        named = [*job.messages, *(node for node in job.again if node not in job.messages)]
        insiders = [threading.Thread(target=_insider, args=(siege, job, node, over, go)) for node in named]
        for insider in insiders:
            insider.start()
        ready = [insider for insider, node in zip(insiders, named, strict=True) if node not in job.again]
        for insider in ready:
            insider.join()
        go.touch()
        ended = siege.ended(60.0)
        over.set()
        for thread in (*insiders, watcher):
            thread.join()
        assert ended is not None, "the run does not end"
    if job.messages:
        _report(ended.folder)
    (folder / "peaks").write_text(json.dumps(peaks))
    if ended.error is not None:
        sys.exit(ended.error.exit_code)


def _insider(siege: Siege, job: Job, node: str, over: threading.Event, go: Path) -> None:
    with suppress(zenoh.ZError), siege.join(node) as session:
        send(session, siege.prefix, job.messages.get(node, ()))
        while node in job.again and not over.wait(0.002):
            send(session, siege.prefix, job.again[node])
            if siege.launch.stopping_since is not None:
                break
            go.touch()


def _watch(siege: Siege, peaks: dict[str, float], over: threading.Event) -> None:
    """Note how much memory each process has taken at most."""
    while not over.wait(0.1):
        nodes = dict(siege.launch.record["nodes"])
        for name, pid in {"launcher": os.getpid(), **{name: node["pid"] for name, node in nodes.items()}}.items():
            with suppress(OSError, StopIteration):
                lines = Path(f"/proc/{pid}/status").read_text().splitlines()
                peak = next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))
                peaks[name] = max(peak, peaks.get(name, 0.0))


def _report(folder: Path) -> None:
    """The report can be written, or says why not."""
    from mast_zenoh.report import html

    try:
        html.write_report(folder)
    except MastError as error:
        print(f"no report: {error}")


if __name__ == "__main__":

    main()
