"""Latency that a link node adds to a message, compared with a bare Python relay.

The same message, tracks of 20 objects, goes from a publisher to a subscriber in this process on five paths:

    direct      through the router
    callback    through the router, a process that forwards messages in Zenoh's own thread, and the router again:
                the lower limit, reached by a program that does nothing else
    relay       the same with a plain loop: `for sample in subscriber: publisher.put(sample.payload)`
    link        the same with a link node, as in a real-time run, without rules
    wired       the same with the rules of the profile `wired`; the delays that they draw are subtracted

Messages are sent one at a time, on all paths in turn. The results are medians of one-way times over blocks of messages,
and the latency added to the direct path, as a multiple of what the relay adds. The multiple is the median of the
blocks' ratios, because the load of the machine differs between blocks.

    python benchmarks/link.py [--messages 200] [--repeats 10] [--objects 20]
"""

from __future__ import annotations

import argparse
import gc
import queue
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from operator import truediv

import numpy as np
import zenoh

from mast_zenoh import links
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config import bundle, loading, registry
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.links import Chain, Passage, Rule
from mast_zenoh.mesh.control import flow, prefix
from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.protocol.traffic import stamp
from mast_zenoh.mesh.session import open_client, open_router
from mast_zenoh.mesh.zenoh_process import ZenohProcess
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Header
from mast_zenoh.streams import stream
from mast_zenoh.wiring import endpoints, maps
from mast_zenoh.wiring.model import Wiring

PATHS = ("direct", "callback", "relay", "link", "wired")
BARE = ("callback", "relay")
KEY = "agent/ego/tracks"
PERIOD_NS = 100_000_000
ROLES = {"simulator": "simulator", "ego": "agent", "broker": "broker", "link_ego": "link"}


MAP = {
    "wire": [
        {"key": "clock", "message": "clock", "from": "simulator.clock", "to": ["link.clock"]},
        {"key": "agent/{agent}/tracks", "message": "tracks", "from": "agent.tracks", "to": ["broker.tracks"]},
    ],
    "insert": [
        {"wire": "agent/{agent}/tracks", "role": "link", "input": "tracks", "output": "tracks_out", "to": "broker"}
    ],
}


def wiring() -> Wiring:
    """The wiring of a link before the broker, and nothing else."""
    link = link_class()
    nodes = {
        "simulator": endpoints.NodeOptions("simulator", {}, {}, {"clock": "clock"}),
        "ego": endpoints.NodeOptions("agent", {}, {}, {"tracks": "tracks"}),
        "broker": endpoints.NodeOptions("broker", {}, {"tracks": "tracks"}, {}),
        "link_ego": endpoints.NodeOptions("link", {"agent": "ego"}, link.inputs, link.outputs, forwards=link.forwards),
    }
    return maps.resolve([("benchmark", MAP)], nodes)


def link_class() -> type:
    """The link node's class, from its file."""
    return loading.node_class(bundle.ROOT / "nodes" / "link.py")


def rules(path: str) -> list[dict]:
    """The rules of the link."""
    return links.profile("wired")["up"] if path == "wired" else []


def message(objects: int) -> bytes:
    """Tracks as an agent sends them."""
    rng = np.random.default_rng(0)
    square = rng.normal(size=(objects, 9, 9))
    states = ObjectStates.of(
        rng.normal(0.0, 30.0, (objects, 3)),
        velocity=rng.normal(0.0, 5.0, (objects, 3)),
        size=np.full((objects, 3), 2.0),
        yaw=rng.uniform(-3.0, 3.0, objects),
        covariance=square @ square.transpose(0, 2, 1),
        score=np.full(objects, 0.9),
        id=np.arange(objects),
    )
    reference = {"origin": np.zeros(3), "rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    return codec.encode(codec.conform(Header("tracks", "ego", 0, 0, 0), states.columns() | reference))


def relay(endpoint: str, path: str) -> None:
    """Main function of a bare relay."""
    with open_client(endpoint) as session:
        out = session.declare_publisher(
            f"{prefix(path)}/out", congestion_control=zenoh.CongestionControl.BLOCK, express=True
        )

        def pass_on(sample: zenoh.Sample) -> None:
            out.put(sample.payload, attachment=sample.attachment)

        if path == "callback":
            session.declare_subscriber(f"{prefix(path)}/in", zenoh.handlers.Callback(pass_on, indirect=False))
            sys.stdin.read()
        else:
            subscriber = session.declare_subscriber(f"{prefix(path)}/in")
            for sample in subscriber:
                pass_on(sample)


def link(endpoint: str, path: str) -> None:
    """Main function of the link node's process."""
    with open_client(endpoint) as session:
        built_rules = tuple(registry.build(rule, Rule, path) for rule in rules(path))
        node = link_class()("ego", built_rules)
        nodes = {"link_ego": NodeSpec("link", "link.py", "", {}, "fail")}
        resolved = Resolved("link", 0, "realtime", 1.0, 1, PERIOD_NS, nodes, wiring().to_json(), {})
        process = ZenohProcess(path, resolved, "link_ego", node, session, Signatures(path))
        gc.freeze()  # as mesh/hosting.py does
        gc.set_threshold(50_000, 20, 20)
        process.run()


def drawn_delay_us(sizes: int, count: int) -> float:
    """The median delay of the profile's rules themselves, µs."""
    built_rules = [registry.build(rule, Rule, "wired") for rule in rules("wired")]
    chain = Chain(built_rules, lambda *purpose: stream(0, "link_ego", "link", "tracks", "ego", *purpose))
    outcomes = [chain.carry(Passage(0, 10**8 * number, sizes)) for number in range(count)]
    return statistics.median(outcome.delay_s for outcome in outcomes if outcome.leaving) * 1e6


class Bench:
    """The publisher and the subscriber of every path."""

    def __init__(self, session: zenoh.Session, listening_session: zenoh.Session, payload: bytes) -> None:
        self.session = session  # messages between ports of one session would not pass through the router
        self.payload = payload
        self.arrivals_ns: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.stamp = stamp(KEY, 1, 0)
        (branch,) = next(wire for wire in wiring().wires if wire.key == KEY).branches
        ends = {path: (f"{prefix(path)}/{KEY}", f"{prefix(path)}/{branch.legs[-1].key}") for path in PATHS}
        ends |= {path: (f"{prefix(path)}/in", f"{prefix(path)}/out") for path in BARE}
        ends["direct"] = ("direct/key", "direct/key")
        self.out = {path: self.publisher(key) for path, (key, _) in ends.items()}
        for _, key in ends.values():
            listening_session.declare_subscriber(key, zenoh.handlers.Callback(self.take, indirect=False))

    def publisher(self, key: str) -> zenoh.Publisher:
        """A publisher with the settings of the testbed's nodes."""
        block = zenoh.CongestionControl.BLOCK
        return self.session.declare_publisher(key, congestion_control=block, express=True)

    def take(self, sample: zenoh.Sample) -> None:
        """Store the time of arrival of a message."""
        self.arrivals_ns.put(time.perf_counter_ns())

    def begin(self, path: str) -> None:
        """Have the node join and start its first frame, as driver and simulator do."""
        epoch = flow.encode_epoch(1, ROLES, None)
        clock = codec.encode(codec.conform(Header("clock", "simulator", 0, 0, 0), {}))
        self.session.put(f"{prefix(path)}/@control/epoch", epoch)
        self.session.put(f"{prefix(path)}/clock", clock, attachment=stamp("clock", 1, 0))

    def send_one(self, path: str, seconds: float = 1.0) -> float | None:
        """One-way time of one message, µs; None if it was lost."""
        start_ns = time.perf_counter_ns()
        self.out[path].put(self.payload, attachment=self.stamp)
        try:
            return (self.arrivals_ns.get(timeout=seconds) - start_ns) * 1e-3
        except queue.Empty:
            return None

    def medians(self, messages: int, paths: Sequence[str] = PATHS) -> dict[str, float]:
        """The median one-way time of messages on each path, µs; sent one at a time, on all paths in turn."""
        times: dict[str, list[float]] = {path: [] for path in paths}
        for _ in range(messages):
            for path in paths:
                if (took := self.send_one(path)) is not None:
                    times[path].append(took)
        return {path: statistics.median(took) for path, took in times.items()}

    def wait_until_connected(self, path: str) -> None:
        """Wait until messages arrive."""
        deadline = time.monotonic() + 30.0
        while self.send_one(path, 0.2) is None:
            if time.monotonic() > deadline:
                raise TimeoutError(f"{path}: no message arrives")
            if path not in ("direct", *BARE):
                self.begin(path)
        try:
            while True:  # messages that waited for the node to start
                self.arrivals_ns.get(timeout=0.5)
        except queue.Empty:
            return


@contextmanager
def running(payload: bytes, paths: Sequence[str] = PATHS[1:]) -> Iterator[Bench]:
    """A router with the processes of some paths, and the direct one."""
    router, endpoint = open_router()
    processes = {
        path: subprocess.Popen([sys.executable, __file__, "--node", endpoint, path], stdin=subprocess.PIPE)
        for path in paths
    }
    try:
        with router, open_client(endpoint) as session, open_client(endpoint) as listening_session:
            bench = Bench(session, listening_session, payload)
            for path in ("direct", *paths):
                bench.wait_until_connected(path)
            yield bench
            for path in set(paths) - set(BARE):
                session.put(f"{prefix(path)}/@control/stop", b"done")
    finally:
        for process in processes.values():
            process.kill()
            process.wait()


def main() -> None:
    """Measure all paths in turn, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--objects", type=int, default=20)
    parser.add_argument("--node", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.node:
        endpoint, path = arguments.node
        relay(endpoint, path) if path in BARE else link(endpoint, path)
        return
    payload = message(arguments.objects)
    with running(payload) as bench:
        blocks = [bench.medians(arguments.messages) for _ in range(arguments.repeats)]
    medians = {path: [block[path] for block in blocks] for path in PATHS}
    medians["wired"] = [value - drawn_delay_us(len(payload), 10_000) for value in medians["wired"]]
    p50 = {path: statistics.median(value) for path, value in medians.items()}
    added = {path: [a - b for a, b in zip(medians[path], medians["direct"], strict=True)] for path in PATHS[1:]}
    size = f"{arguments.objects} objects, {len(payload)} bytes"
    print(f"one way through a router, {size}, p50 of {arguments.messages} messages in each block")
    print(f"{'':8}{'µs (median)':>12}{'added':>8}{'of relay':>10}{'of callback':>13}   blocks")
    for path in PATHS:
        comparison = " " * 31
        if path in added:
            of = {bare: statistics.median(map(truediv, added[path], added[bare])) for bare in BARE}
            comparison = f"{statistics.median(added[path]):8.0f}{of['relay']:10.2f}{of['callback']:13.2f}"
        print(f"{path:8}{p50[path]:12.0f}{comparison}   {', '.join(f'{value:.0f}' for value in medians[path])}")


if __name__ == "__main__":
    main()
