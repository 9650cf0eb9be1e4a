"""The deterministic cost of a frame, by role, and the functions that cause it.

    python benchmarks/cost.py             # table of costs, compared with the budgets; exit code 1 if one is exceeded
    python benchmarks/cost.py --write     # make these costs the budgets (budgets.toml)

Three runs on the generated junction are recorded: what each node receives, in order. Then the nodes of one role at a
time receive the same messages again, encoded as on a mesh, in a process of their own with a fixed hash seed. The first
frames warm up the interpreter; the others, and the end of the run, are counted:

    instructions    of the processor, by compiled function of Python, NumPy and kernels (valgrind's callgrind)
    bytes           allocated, within each Python function; memory freed and taken again between two calls counts once
    calls           of Python functions, within each Python function
    messages, encoded_bytes     published, by the last part of the key

None of them depends on the machine's speed or load. They depend on the versions of Python, NumPy and the C compiler,
which the budgets therefore name.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import pickle
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import tracemalloc
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh import kernels, scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.mesh.host import Outgoing
from mast_zenoh.mesh.inproc import InProcess

BUDGETS = Path(__file__).with_name("budgets.toml")
#: Name of a run: its scenario and settings.
RUNS = {
    "baseline": ("baseline", []),
    "attacked": ("coordinated", ["attack_start_s=0.2"]),
    "defended": ("defended", ["attack_start_s=0.2", "defence=FaultOrLie"]),
}
WARM_UP, COUNTED = 10, 10  # frames
MARGIN = 0.03  # that a cost may exceed its budget
TOP = 12  # functions kept with a budget
#: Modules within which everything happens, so that they explain nothing.
HARNESS = ("__main__", "mast_zenoh.mesh.host")
#: Ending of the module of a node's file, which depends on the folder.
NODE_FILE = re.compile(r"_[0-9a-f]{12}$")
MEASURES = ("instructions", "bytes", "calls", "messages", "encoded_bytes")
#: Nothing else of the process's environment reaches the processes that count.
ENVIRONMENT = {
    "PATH": "/usr/bin:/bin",
    "PYTHONHASHSEED": "0",
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": "65536",  # large buffers grow without being copied, whatever is next to them
}

#: Costs of a frame, by run, role, measure and function; and their total, as "total".
Costs = dict[str, dict[str, dict[str, dict[str, float]]]]


class Event(NamedTuple):
    """A delivery to a node, with the arguments of `Host.deliver`; or None: the node publishes the next frame."""

    frame: int
    node: str
    delivery: tuple[Any, ...] | None


class Recorded(InProcess):
    """A run that keeps its events."""

    def __init__(self, resolved: Resolved) -> None:
        super().__init__(resolved, encode=True)
        self.events: list[Event] = []
        for name, host in self.hosts.items():
            host.deliver = partial(self._deliver, name, host.deliver)

    def _advance(self, source: Any, frame: int) -> bool:
        self.frame = frame
        self.events.append(Event(frame, source.name, None))
        return super()._advance(source, frame)

    def _deliver(self, name: str, deliver: Any, *delivery: Any, flaw: str) -> None:
        self.events.append(Event(self.frame, name, delivery))
        deliver(*delivery, flaw=flaw)


class Replayed(InProcess):
    """The nodes of one role, which receive what they received in a recorded run; `sent` counts what they publish."""

    def __init__(self, resolved: Resolved, role: str) -> None:
        super().__init__(resolved, encode=True)
        roles = {name: spec.role for name, spec in resolved.nodes.items()}
        self.sent: dict[str, Counter[str]] = {"messages": Counter(), "encoded_bytes": Counter()}
        self.hosts = {name: host for name, host in self.hosts.items() if roles[name] == role}
        for name, host in self.hosts.items():
            host.start({peer: of for peer, of in roles.items() if peer != name})

    def _enqueue(self, message: Outgoing) -> None:
        for name in ("total", message.key.rpartition("/")[2]):
            self.sent["messages"][name] += 1
            self.sent["encoded_bytes"][name] += len(message.payload)

    def play(self, events: list[Event]) -> None:
        """Deliver to each node what it received."""
        for _, name, delivery in events:
            host = self.hosts[name]
            if delivery is None:
                self._advance(host, 0)
            else:
                host.deliver(*delivery)

    def finish(self) -> None:
        """Finish all nodes."""
        for host in self.hosts.values():
            host.finish()


class Tally(AbstractContextManager["Tally"]):
    """Counts calls and bytes within Python functions: a function's include those of the functions that it calls."""

    def __init__(self) -> None:
        self._total = {"calls": 0, "bytes": 0}
        self._within: dict[str, Counter[tuple[str, str]]] = {"calls": Counter(), "bytes": Counter()}
        self._stack: list[tuple[tuple[str, str], int, int]] = []  # module and name; calls and bytes at its begin
        self._active: Counter[tuple[str, str]] = Counter()
        self._before = 0  # bytes in use after the last event

    def __enter__(self) -> Tally:
        tracemalloc.start()
        sys.setprofile(self._event)
        return self

    def __exit__(self, *error: object) -> None:
        sys.setprofile(None)
        tracemalloc.stop()

    def _event(self, frame: FrameType, event: str, argument: object) -> None:
        total = self._total
        total["bytes"] += tracemalloc.get_traced_memory()[1] - self._before
        if event == "call":
            function = (frame.f_globals["__name__"], frame.f_code.co_qualname)
            self._stack.append((function, total["calls"], total["bytes"]))
            self._active[function] += 1
            total["calls"] += 1
        elif event == "return" and self._stack:
            function, calls, allocated = self._stack.pop()
            self._active[function] -= 1
            if not self._active[function]:  # otherwise it has called itself
                self._within["calls"][function] += total["calls"] - calls
                self._within["bytes"][function] += total["bytes"] - allocated
        tracemalloc.reset_peak()
        self._before = tracemalloc.get_traced_memory()[0]

    def costs(self) -> dict[str, dict[str, int]]:
        """By measure and function, and in total."""
        costs = {measure: {"total": total} for measure, total in self._total.items()}
        for measure, within in self._within.items():
            for (module, name), cost in within.items():
                if module not in HARNESS:
                    function = f"{NODE_FILE.sub('', module)}.{name}"
                    costs[measure][function] = costs[measure].get(function, 0) + cost
        return costs


class Section(AbstractContextManager[None]):
    """What callgrind counts and writes into a file of its own.

    It begins and ends with a call of a C function that nothing else calls (ctypes would hide the call from callgrind).
    """

    def __enter__(self) -> None:
        os.getpgrp()

    def __exit__(self, *error: object) -> None:
        os.ctermid()


CALLGRIND = (
    *("--quiet", "--tool=callgrind", "--zero-before=getpgrp", "--dump-before=ctermid"),
    *("--compress-strings=no", "--compress-pos=no", "--callgrind-out-file=out"),
)


def record(file: Path, runs: Sequence[str]) -> None:
    """Record these of RUNS into a file."""
    recorded = {}
    for name in runs:
        scenario_name, settings = RUNS[name]
        path, loaded = scenario.load(scenario_name, settings)
        resolved = scenario.resolve(path, loaded, frames=WARM_UP + COUNTED, record=True)
        with tempfile.TemporaryDirectory(dir=file.parent) as folder:
            process = Recorded(resolved.in_folder(Path(folder)))
            process.run()
        recorded[name] = resolved, process.events
    file.write_bytes(pickle.dumps(recorded))


def replay(file: Path, *, tally: bool) -> None:
    """Replay every role of the recorded runs, and print the costs as JSON.

    tally: count calls, bytes and messages; otherwise costs are empty, and callgrind counts instructions
    """
    meter = Tally if tally else Section
    costs = {}
    runs = pickle.loads(file.read_bytes())
    for run in (next(iter(runs)), *runs):  # the first run twice, because some work is done once in a process
        resolved, events = runs[run]
        roles = dict.fromkeys(spec.role for spec in resolved.nodes.values())
        costs[run] = {role: replay_role(resolved, events, role, meter()) for role in roles}
    print(json.dumps(costs))


def replay_role(
    resolved: Resolved, events: list[Event], role: str, meter: AbstractContextManager[Tally | None]
) -> dict[str, Counter[str]]:
    """Replay one role, the frames after the first ones within `meter`; by measure and function, what it tallied."""
    with tempfile.TemporaryDirectory(dir=".") as folder:
        nodes = Replayed(resolved.in_folder(Path(folder)), role)
        own = [event for event in events if event.node in nodes.hosts]
        nodes.play([event for event in own if event.frame < WARM_UP])
        counted = [event for event in own if event.frame >= WARM_UP]
        for published in nodes.sent.values():
            published.clear()
        gc.collect()
        gc.freeze()
        with meter as tally:
            nodes.play(counted)
            nodes.finish()
    return tally.costs() | nodes.sent if tally else {}


def measure(*, instructions: bool, runs: Sequence[str] = tuple(RUNS)) -> Costs:
    """Costs of a frame of these of RUNS: instructions, or all else."""
    with tempfile.TemporaryDirectory() as folder:
        recorded = Path(folder) / "recorded"
        python = (sys.executable, str(Path(__file__).resolve()))
        where = {"cwd": folder, "env": ENVIRONMENT | {"XDG_CACHE_HOME": folder}, "check": True}
        subprocess.run([*python, "--record", recorded, *runs], **where)
        command = [*python, "--replay", recorded]
        if instructions:
            command = [shutil.which("valgrind"), *CALLGRIND, *command, "--sections"]
        costs = json.loads(subprocess.run(command, stdout=subprocess.PIPE, **where).stdout)
        if instructions:
            sections = [measures for roles in costs.values() for measures in roles.values()]
            dumps = sorted(Path(folder).glob("out.*"), key=lambda dump: int(dump.suffix[1:]))
            for measures, dump in zip(sections, dumps[-len(sections) :], strict=True):
                measures["instructions"] = by_function(dump)
    return {
        run: {
            role: {
                measure: {function: round(cost / COUNTED, 1) for function, cost in counted.items()}
                for measure, counted in measures.items()
            }
            for role, measures in roles.items()
        }
        for run, roles in costs.items()
    }


def by_function(dump: Path) -> Counter[str]:
    """Instructions by compiled function, without those of the functions that it calls; and in total.

    dump: a file of callgrind (see "Callgrind Format Specification" in its manual), names and positions not compressed
    """
    costs: Counter[str] = Counter()
    function = library = ""
    inclusive = False  # whether the next line is the cost of a call
    for line in dump.read_text(errors="replace").splitlines():
        if line.startswith("ob="):
            library = Path(line[3:]).name.partition(".")[0]
        elif line.startswith("fn="):
            function = readable(line[3:], library)
        elif line.startswith("calls="):
            inclusive = True
        elif line[:1].isdigit():
            if not inclusive:
                costs[function] += int(line.split()[1])
                costs["total"] += int(line.split()[1])
            inclusive = False
    return costs


def readable(name: str, library: str) -> str:
    """The name of a compiled function.

    A library without symbols is one function; a kernel has Cython's numbers removed, which change with its neighbours.
    """
    if name.startswith("0x"):
        return library
    name = name.partition("'")[0]  # callgrind numbers recursive calls
    kernel = re.match(r"__pyx_[a-z]+_10mast_zenoh_7kernels_\d+([a-z]+)_\d*(\w+)", name)
    return f"kernels.{kernel[1]}.{kernel[2]}" if kernel else name


def versions() -> dict[str, str]:
    """What costs depend on, besides the code."""
    cc = shutil.which("cc")
    version = subprocess.run([cc, "-dumpfullversion"], stdout=subprocess.PIPE, text=True).stdout.strip() if cc else ""
    return {
        "python": platform.python_version(),
        "python_compiler": platform.python_compiler(),
        "numpy": np.__version__,
        "cc": version,
        "libc": " ".join(platform.libc_ver()),
        "machine": platform.machine(),
    }


def missing(*, instructions: bool) -> str:
    """What is missing here to measure costs; "" if nothing is."""
    if reason := kernels.why_not():
        return f"costs are those with compiled kernels: {reason}"
    if instructions and not shutil.which("valgrind"):
        return "valgrind, which counts instructions, is not installed"
    return ""


def why_not(*, instructions: bool) -> str:
    """Why costs cannot be compared with the budgets here; "" if they can."""
    if reason := missing(instructions=instructions):
        return reason
    budgets, here = load()["versions"], versions()
    relevant = here if instructions else ("python", "numpy")
    other = [f"{name} is {here[name]}, expected {budgets[name]}" for name in relevant if here[name] != budgets[name]]
    return f"the budgets are for other versions: {', '.join(other)}" if other else ""


def load() -> dict[str, Any]:
    """The budgets: {"versions": see `versions`, run: {role: {measure: {"total": …, function: …}}}}."""
    return tomllib.loads(BUDGETS.read_text(encoding="utf-8"))


def excesses(costs: Costs, budgets: Mapping[str, Any]) -> list[str]:
    """What costs more than its budget, with the functions whose cost grew most; a role without a budget, too."""
    found = []
    for run, roles in costs.items():
        for role, measures in roles.items():
            for measure, cost in measures.items():
                budget = budgets.get(run, {}).get(role, {}).get(measure, {"total": 0.0})
                if cost.get("total", 0.0) > (1 + MARGIN) * budget["total"]:
                    more = f"{cost['total'] / budget['total'] - 1:+.1%}" if budget["total"] else "no budget"
                    grown = ", ".join(growth(cost, budget))
                    found.append(f"{run}, {role}: {cost['total']:,.1f} {measure} a frame ({more}): {grown}")
    return found


def growth(cost: Mapping[str, float], budget: Mapping[str, float]) -> list[str]:
    """The functions whose cost grew most, with the growth.

    budget: the costliest functions before; any other cost at most as much as the least of them
    """
    floor = min(budget.values()) if len(budget) > TOP else 0.0
    grown = {name: now - budget.get(name, floor) for name, now in cost.items() if name != "total"}
    most = sorted(grown, key=lambda name: (-grown[name], name))[:TOP]
    return [f"{name} {grown[name]:+,.1f}" for name in most if grown[name] > 0]


def write(costs: Costs) -> None:
    """Make costs the budgets."""
    lines = ["# Cost of a frame by run, role and measure, and its costliest functions: benchmarks/cost.py --write."]
    lines += ["[versions]", *(f'{name} = "{version}"' for name, version in versions().items())]
    for run, roles in costs.items():
        for role, measures in roles.items():
            for measure in MEASURES:
                if cost := measures.get(measure):
                    lines += ["", f"[{run}.{role}.{measure}]"]
                    names = sorted(cost, key=lambda name: (name != "total", -cost[name], name))
                    lines += [f'"{name}" = {cost[name]:.1f}' for name in names[: 1 + TOP]]
    BUDGETS.write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> int:
    """Measure, then compare or write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="make these costs the budgets")
    parser.add_argument("--record", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--replay", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("runs", nargs="*", help=argparse.SUPPRESS)
    parser.add_argument("--sections", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.record:
        record(arguments.record, arguments.runs)
        return 0
    if arguments.replay:
        replay(arguments.replay, tally=not arguments.sections)
        return 0
    if arguments.write and (reason := missing(instructions=True)):
        parser.error(f"--write: {reason}")
    if not arguments.write and (reason := why_not(instructions=True)):
        print(f"not fully comparable with the budgets: {reason}", file=sys.stderr)
    costs = measure(instructions=False)
    for run, roles in measure(instructions=True).items() if shutil.which("valgrind") else ():
        for role, measures in roles.items():
            costs[run][role] |= measures
    if arguments.write:
        write(costs)
    print(f"{'a frame':24}" + "".join(f"{measure:>16}" for measure in MEASURES))
    for run, roles in costs.items():
        for role, measures in roles.items():
            totals = [measures.get(measure, {}).get("total", 0.0) for measure in MEASURES]
            print(f"{run + ', ' + role:24}" + "".join(f"{total:16,.0f}" for total in totals))
    exceeded = excesses(costs, load())
    print("", *exceeded, sep="\n")
    return bool(exceeded)


if __name__ == "__main__":
    sys.exit(main())
