"""What a flood of objects from one agent costs the others: frames/s with the flood, divided by that without it.

    python benchmarks/flood.py [CONFIGURATION ...] [--rows 20000] [--rounds 5] [--frames 150] [--mesh]

In one process, the processor time of all nodes but the adversary counts, without the end of the run; an adversary that
floods takes many times as long as all the others. They are compared with a run whose adversary makes the same flood and
then does not send it: making it empties the caches that all nodes of one process share. With --mesh it is the frame
rate of lock-step runs of processes, which wait for the adversary, too, against an adversary that does nothing. Runs
without and with the flood alternate. The median of the ratios is printed, and the least and the greatest; and the
objects of the ego's picture that are missed, without and with the flood.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.arrays.states import Floats, ObjectStates
from mast_zenoh.attacks.flood import Flood
from mast_zenoh.attacks.targets import Tampering, Targets
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.mesh.host import Host
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages.codec import conform
from mast_zenoh.messages.schemas import Header

CPM = {"agents.*.tracks_from": "agent"}
ON_TRACKS = {"n_adversaries": 1, "keyexpr.rewrites": ["on_tracks.toml"]}
#: Scenario and settings, by name.
CONFIGURATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "centre": ("uncoordinated", ON_TRACKS),
    "centre, max_rows=20000": ("uncoordinated", ON_TRACKS | {"run.max_rows": 20_000}),
    "centre, cpm": ("uncoordinated", CPM | ON_TRACKS | {"keyexpr.rewrites": ["cpm.toml", "on_tracks.toml"]}),
    "two centres": ("two_centres", {"n_adversaries": 1}),
    "peers": ("peers", {"n_adversaries": 1}),
    "peers, cpm": ("peers", {"n_adversaries": 1, "codec": "cpm"}),
}
START_S = 1.0


class UnsentFlood(Flood):
    """Makes a flood and its message, and sends what was seen instead."""

    def step(
        self, frame: int, time_ns: int, objects: ObjectStates, agent_position: Floats, directive: Targets | None = None
    ) -> Tampering:
        added = super().step(frame, time_ns, objects, agent_position, directive).added
        at = {"origin": agent_position, "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
        conform(Header("tracks", "nobody", frame, time_ns, 0), added.columns() | at)
        return Tampering.nothing(len(objects))


class Timed(InProcess):
    """A run that adds up the processor time of each node, ns, in its handlers."""

    def __init__(self, resolved: Resolved) -> None:
        super().__init__(resolved)
        self.spent: Counter[str] = Counter()
        for host in self.hosts.values():
            self._time(host)

    def _time(self, host: Host) -> None:
        deliver = host.deliver

        def timed(*arguments: Any, **options: Any) -> None:
            began = time.process_time_ns()
            deliver(*arguments, **options)
            self.spent[host.name] += time.process_time_ns() - began

        host.deliver = timed


def in_process(name: str, settings: dict[str, Any], attack: dict[str, Any], frames: int) -> tuple[float, float]:
    """Seconds of a frame of all nodes but the adversary; objects that the ego's picture misses."""
    path, loaded = scenario.load(name, [f"{key}={value}" for key, value in settings.items()])
    loaded["adversaries"]["adversary_1"]["attack"] = attack
    process = Timed(scenario.resolve(path, loaded, frames=frames))
    results = process.run()
    others = sum(spent for node, spent in process.spent.items() if node != "adversary_1")
    return others * 1e-9 / frames, missed(results["evaluator"]["metrics"])


def on_mesh(name: str, settings: dict[str, Any], attack: dict[str, Any], frames: int) -> tuple[float, float]:
    """Seconds of a frame of a run of processes; objects that the ego's picture misses."""
    more = settings | {"adversaries.adversary_1.attack": attack}
    with tempfile.TemporaryDirectory() as folder:
        run = mast.run(name, frames=frames, out=f"{folder}/run", runtime="mesh", record=False, report=False, **more)
        return 1.0 / run.record["timings"]["frames_per_second"], missed(
            json.loads(Path(folder, "run", "metrics.json").read_text("utf-8"))
        )


def missed(metrics: Any) -> float:
    """Objects a frame that the first agent's picture misses."""
    return float(next(iter(metrics["agents"].values()))["picture"]["fn"]["mean"])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("configurations", nargs="*", default=list(CONFIGURATIONS))
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--mesh", action="store_true")
    arguments = parser.parse_args()
    measure = on_mesh if arguments.mesh else in_process
    flood = dict(type="Flood", rows=arguments.rows, start_s=START_S)
    without = dict(type="PassThrough") if arguments.mesh else flood | dict(type="UnsentFlood")
    print(f"{'':28}{'median':>8}{'least':>8}{'most':>8}{'missed':>10}{'flooded':>9}")
    for label in arguments.configurations:
        name, settings = CONFIGURATIONS[label]
        sides = [without, flood]
        ratios = []
        for _ in range(arguments.rounds):
            sides.reverse()
            found = {attack["type"]: measure(name, settings, attack, arguments.frames) for attack in sides}
            (before, seen), (after, flooded) = found[without["type"]], found["Flood"]
            ratios.append(before / after)
        cells = [f"{value:8.2f}" for value in (statistics.median(ratios), min(ratios), max(ratios))]
        print(f"{label:28}", *cells, f"{seen:10.2f}{flooded:9.2f}", sep="", flush=True)


if __name__ == "__main__":
    main()
