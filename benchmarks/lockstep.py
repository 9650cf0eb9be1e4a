"""Lock-step frames/s of the testbed beside those of bare messages over the same graph and payload sizes, in one run.

The bare loop has the same processes, router, keys and payload sizes, and does nothing else: an agent publishes when
its pose and detections are there, the broker when all tracks are there, the centre when the batch is there, and the
simulator begins the next frame when it hears the picture. What the testbed adds to that is the price of what it
computes and of its lock-step.

    python benchmarks/lockstep.py [--frames 600] [--repeats 3]
"""

from __future__ import annotations

import argparse
import json
import queue
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import zenoh

from mast_zenoh import scenario
from mast_zenoh.keyexpr import Wiring
from mast_zenoh.launch import local
from mast_zenoh.runtime.inproc import InProcess
from mast_zenoh.runtime.session import open_client, open_router

#: What a node of a role waits for before it publishes, in the bare loop.
TRIGGERS = {
    "agent": ("pose", "detections"),
    "broker": ("tracks",),
    "command_center": ("collated",),
    "simulator": ("picture",),
}
PREFIX = "bare/"


def payload_sizes(resolved: scenario.Resolved) -> dict[str, int]:
    """Mean bytes of a message on each key."""
    sizes: dict[str, list[int]] = defaultdict(list)
    InProcess(resolved, encode=True, tap=lambda sent: sizes[sent.key].append(len(sent.payload))).run()
    return {key: round(statistics.mean(found)) for key, found in sizes.items()}


def testbed(resolved: scenario.Resolved, frames: int) -> float:
    """Frames/s of the testbed on its mesh."""
    with tempfile.TemporaryDirectory() as out:
        ended = local.run(resolved, Path(out) / "run")
        if ended.error:
            raise ended.error
        return float(ended.record["timings"]["frames_per_second"])


def bare(resolved: scenario.Resolved, sizes: dict[str, int], frames: int) -> float:
    """Frames/s of bare messages over the same graph."""
    router, endpoint = open_router()
    with router, tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / "plan.json"
        roles = {name: spec.role for name, spec in resolved.nodes.items()}
        plan.write_text(json.dumps({"wiring": resolved.wiring, "roles": roles, "sizes": sizes, "frames": frames}))
        processes = {
            name: subprocess.Popen(
                [sys.executable, __file__, "--node", name, str(plan), endpoint], stdout=subprocess.PIPE
            )
            for name in roles
        }
        try:
            answer, _ = processes["simulator"].communicate(timeout=300)
            return float(answer)
        finally:
            router.put(PREFIX + "@stop", b"")
            for process in processes.values():
                try:
                    process.wait(5)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()


def bare_node(name: str, plan_file: str, endpoint: str) -> None:
    """One process of the bare loop."""
    plan = json.loads(Path(plan_file).read_text())
    wiring, role = Wiring.from_json(plan["wiring"]), plan["roles"][name]
    inbox: queue.SimpleQueue[str] = queue.SimpleQueue()
    with open_client(endpoint) as session:

        def listen(key: str) -> None:
            handler = zenoh.handlers.Callback(
                lambda sample: inbox.put(key) if sample.payload.to_bytes() is not None else 0, indirect=False
            )
            subscribers.append(session.declare_subscriber(PREFIX + key, handler))

        subscribers: list = []
        ports = wiring.ports(name)
        hears = dict.fromkeys(ports.inputs) | ({"cc/picture": None} if role == "simulator" else {})
        triggers = {key for key, found in ports.inputs.items() if found.message in TRIGGERS.get(role, ())}
        triggers |= {"cc/picture"} if role == "simulator" else set()
        if role == "agent":
            triggers -= {key for key in triggers if "picture" in key}
        for key in (*hears, "@stop"):
            listen(key)
        publishers = [
            (
                session.declare_publisher(PREFIX + key, congestion_control=zenoh.CongestionControl.BLOCK, express=True),
                b"x" * plan["sizes"][key],
            )
            for key in ports.outputs.values()
            if key in plan["sizes"] and not key.endswith("status")
        ]
        for publisher, _ in publishers:
            while not publisher.matching_status:
                time.sleep(0.001)
        alive = session.liveliness().declare_token(f"{PREFIX}@alive/{name}")
        missing = set(triggers)

        def publish() -> None:
            for publisher, payload in publishers:
                publisher.put(payload)

        def turn() -> bool:
            """Handle one message; False when told to stop."""
            key = inbox.get()
            missing.discard(key)
            return key != "@stop"

        if role != "simulator":
            while turn():
                if triggers and not missing:
                    missing |= triggers
                    publish()
        else:
            while len({str(r.ok.key_expr) for r in session.liveliness().get(f"{PREFIX}@alive/*")}) < len(plan["roles"]):
                time.sleep(0.01)
            begun = time.perf_counter()
            for _ in range(plan["frames"]):
                publish()
                while missing:
                    turn()
                missing |= triggers
            print(plan["frames"] / (time.perf_counter() - begun), flush=True)
        alive.undeclare()


def main() -> None:
    """Measure both, alternating, and print them side by side."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--node", nargs=3, metavar=("NAME", "PLAN", "ENDPOINT"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.node:
        bare_node(*arguments.node)
        return
    path, loaded = scenario.load("baseline")
    resolved = scenario.resolve(path, loaded, frames=arguments.frames)
    sizes = payload_sizes(resolved)
    rates: dict[str, list[float]] = {"bare messages": [], "testbed": []}
    for _ in range(arguments.repeats):
        rates["bare messages"].append(bare(resolved, sizes, 3 * arguments.frames))
        rates["testbed"].append(testbed(resolved, arguments.frames))
    agents = sum(spec.role == "agent" for spec in resolved.nodes.values())
    print(f"lock-step on the mesh: {resolved.name}, {len(resolved.nodes)} processes, {agents} agents")
    print(f"payload bytes: {', '.join(f'{key} {size}' for key, size in sizes.items() if 'infra' not in key)}")
    print(f"{'':16}{'frames/s (median)':>20}{'ms/frame':>12}   runs")
    median = {name: statistics.median(found) for name, found in rates.items()}
    for name, found in rates.items():
        runs = ", ".join(f"{rate:.0f}" for rate in found)
        print(f"{name:16}{median[name]:20.0f}{1000 / median[name]:12.2f}   {runs}")
    print(f"ratio testbed / bare: {median['testbed'] / median['bare messages']:.2f}")


if __name__ == "__main__":
    main()
