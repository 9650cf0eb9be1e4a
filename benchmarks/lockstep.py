"""Lock-step frames/s of the testbed, compared with bare messages.

Bare messages have the same graph and payload sizes.

The bare loops have the same processes, router, keys and payload sizes, and do nothing else: an agent publishes when its
pose and detections have arrived, the broker when all tracks have, the centre when the batch has. They differ in when
the simulator begins the next frame:

    bare, lock-step     when every process has acknowledged all messages of this frame (one empty message each)
    bare, no barrier    when it receives the picture, even if other nodes are still busy: the limit of the transport

The difference from the testbed is the cost of its computations. It runs without a recorder here.

    python benchmarks/lockstep.py [--frames 150] [--repeats 3] [--poles 4]
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
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import run
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.mesh.session import open_client, open_router
from mast_zenoh.wiring.model import Wiring

#: By role, the messages that a node of the bare loop waits for before it publishes.
TRIGGERS = {"agent": ("pose", "detections"), "broker": ("tracks",), "command_center": ("collated",)}
PICTURE = "cc/picture"
PREFIX = "bare/"


def payload_sizes(resolved: Resolved) -> dict[str, int]:
    """Mean bytes of a message on each key."""
    sizes: dict[str, list[int]] = defaultdict(list)
    InProcess(resolved, encode=True, tap=lambda sent: sizes[sent.key].append(len(sent.payload))).run()
    return {key: round(statistics.mean(values)) for key, values in sizes.items()}


def testbed(resolved: Resolved) -> float:
    """Frames/s of the testbed on its mesh."""
    with tempfile.TemporaryDirectory() as out:
        finished = run.run(resolved, Path(out) / "run")
        if finished.error:
            raise finished.error
        return float(finished.record["timings"]["frames_per_second"])


def bare(resolved: Resolved, sizes: dict[str, int], frames: int, *, barrier: bool) -> float:
    """Frames/s of bare messages over the same graph."""
    router, endpoint = open_router()
    with router, tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / "plan.json"
        roles = {name: spec.role for name, spec in resolved.nodes.items()}
        content = {"wiring": resolved.wiring, "roles": roles, "sizes": sizes, "frames": frames, "barrier": barrier}
        plan.write_text(json.dumps(content))
        command = [sys.executable, __file__, "--node"]
        processes = {
            name: subprocess.Popen([*command, name, str(plan), endpoint], stdout=subprocess.PIPE) for name in roles
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


class BareNode:
    """One process of the bare loop."""

    def __init__(self, name: str, plan: dict, session: zenoh.Session) -> None:
        self.session = session
        self.inbox: queue.SimpleQueue[str] = queue.SimpleQueue()
        ports = Wiring.from_json(plan["wiring"]).ports(name)
        role, others = plan["roles"][name], sorted(plan["roles"].keys() - {name})
        message_types = {key: input_.message for key, input_ in ports.inputs.items() if input_.message != "status"}
        if role == "simulator":
            acknowledged = [f"@ack/{other}" for other in others]
            self.triggers = set(acknowledged if plan["barrier"] else [PICTURE])
            message_types = dict.fromkeys(self.triggers, "")
        else:
            self.triggers = {key for key, message in message_types.items() if message in TRIGGERS.get(role, ())}
        self.expected = set(message_types)
        sends = [key for key in ports.outputs.values() if not key.endswith("/status")]
        self.acknowledges = plan["barrier"] and role != "simulator"
        self.subscribers = [self._listen(key) for key in (*message_types, "@stop")]
        self.publishers = [(self._publisher(key), b"x" * plan["sizes"][key]) for key in sends]
        self.ack = self._publisher(f"@ack/{name}")
        for publisher, _ in self.publishers:
            while not publisher.matching_status:
                time.sleep(0.001)

    def _listen(self, key: str) -> zenoh.Subscriber:
        def take(sample: zenoh.Sample) -> None:
            sample.payload.to_bytes()
            self.inbox.put(key)

        return self.session.declare_subscriber(PREFIX + key, zenoh.handlers.Callback(take, indirect=False))

    def _publisher(self, key: str) -> zenoh.Publisher:
        block = zenoh.CongestionControl.BLOCK
        return self.session.declare_publisher(PREFIX + key, congestion_control=block, express=True)

    def publish(self) -> None:
        """Publish one message on every key."""
        for publisher, payload in self.publishers:
            publisher.put(payload)

    def follow(self) -> None:
        """Publish whenever all triggering messages have arrived, until stopped."""
        missing, expected = set(self.triggers), set(self.expected)
        while (key := self.inbox.get()) != "@stop":
            missing.discard(key)
            expected.discard(key)
            if self.triggers and not missing:
                missing |= self.triggers
                self.publish()
            if not expected:
                expected |= self.expected
                if self.acknowledges:
                    self.ack.put(b"")

    def drive(self, frames: int) -> float:
        """Drive a number of frames; returns frames/s."""
        begun = time.perf_counter()
        for _ in range(frames):
            missing = set(self.triggers)
            self.publish()
            while missing:
                missing.discard(self.inbox.get())
        return frames / (time.perf_counter() - begun)


def bare_node(name: str, plan_file: str, endpoint: str) -> None:
    """Main function of one process of the bare loop."""
    plan = json.loads(Path(plan_file).read_text())
    with open_client(endpoint) as session:
        node = BareNode(name, plan, session)
        liveliness = session.liveliness()
        alive = liveliness.declare_token(f"{PREFIX}@alive/{name}")
        if plan["roles"][name] == "simulator":
            while len({str(r.ok.key_expr) for r in liveliness.get(f"{PREFIX}@alive/*")}) < len(plan["roles"]):
                time.sleep(0.01)
            print(node.drive(plan["frames"]), flush=True)
        else:
            node.follow()
        alive.undeclare()


def main() -> None:
    """Measure all variants in turn, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--poles", type=int, default=4, help="infrastructure agents, next to the ego vehicle")
    parser.add_argument("--node", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.node:
        bare_node(*arguments.node)
        return
    path, loaded = scenario.load("baseline", [f"n_infrastructure={arguments.poles}"])
    resolved = scenario.resolve(path, loaded, frames=arguments.frames)
    sizes = payload_sizes(resolved)
    rates: dict[str, list[float]] = defaultdict(list)
    for _ in range(arguments.repeats):
        rates["bare, no barrier"].append(bare(resolved, sizes, 3 * arguments.frames, barrier=False))
        rates["bare, lock-step"].append(bare(resolved, sizes, 3 * arguments.frames, barrier=True))
        rates["testbed"].append(testbed(resolved))
    agents = sum(spec.role == "agent" for spec in resolved.nodes.values())
    print(f"lock-step on the mesh: {resolved.name}, {len(resolved.nodes)} processes, {agents} agents")
    print(f"payload bytes: {', '.join(f'{key} {size}' for key, size in sizes.items() if 'infra' not in key)}")
    print(f"{'':18}{'frames/s (median)':>18}{'ms/frame':>10}{'testbed/this':>14}   runs")
    median = {name: statistics.median(values) for name, values in rates.items()}
    for name, values in rates.items():
        runs = ", ".join(f"{rate:.0f}" for rate in values)
        ratio = median["testbed"] / median[name]
        print(f"{name:18}{median[name]:18.0f}{1000 / median[name]:10.2f}{ratio:14.2f}   {runs}")


if __name__ == "__main__":
    main()
