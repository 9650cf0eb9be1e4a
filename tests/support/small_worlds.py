"""Small worlds of the simulation: five nodes, all of whose results depend on every message."""

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mast_zenoh.config.resolved import NodeSpec, ProcessStep, Resolved
from mast_zenoh.mesh.control.interception import Intercept
from mast_zenoh.node import Context, Node, Received, Source
from mast_zenoh.testing.simulation import SimulatedWorld
from mast_zenoh.wiring.insertion import InsertionPoint
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring

PERIOD_NS = 20_000_000  #: of the scene, ns


def _number(value: int) -> dict[str, np.ndarray]:
    """The body of a message that carries one number."""
    column = np.array([value % (1 << 31)], np.int64)
    return {"mobile": np.zeros(1, np.uint8), "detections": column, "tracks": column}


class SmallNode(Node):
    """Notes each message that it handles; its results are a digest of them, whatever their order."""

    def __init__(self) -> None:
        self.handled: Counter[tuple[str, str, int, int, int]] = Counter()
        self.newest: dict[tuple[str, str], int] = {}
        self.disordered = 0

    def note(self, port: str, received: Received) -> int:
        """Note a message; returns its number."""
        value = int(received.body["detections"][0])
        number = received.message.header.seq
        self.handled[port, received.subject, received.frame, number, value] += 1
        self.disordered += number < self.newest.get((port, received.subject), 0)
        self.newest[port, received.subject] = number
        return value

    def finish(self, context: Context) -> dict[str, Any]:
        """A digest of all messages; how many of them came twice or after later ones, and how many are missing."""
        digest = hashlib.sha256(repr(sorted(self.handled)).encode()).hexdigest()
        twice = sum(count - 1 for count in self.handled.values())
        numbers: dict[tuple[str, str], set[int]] = {}
        for port, subject, _, number, _ in self.handled:
            numbers.setdefault((port, subject), set()).add(number)
        missing = sum(max(of_wire) + 1 - len(of_wire) for of_wire in numbers.values())
        counts = {"handled": len(self.handled), "twice": twice, "missing": missing, "disordered": self.disordered}
        return {"digest": digest, **counts}


class Ticker(Source):
    """Drives a scene of some frames: the clock, and a number for each agent."""

    role = "simulator"
    outputs = {"clock": "clock", "number": "status"}
    period_ns = PERIOD_NS

    def __init__(self, frames: int, agents: tuple[str, ...]) -> None:
        self.frames = frames
        self.agents = agents
        self.frame = -1

    def advance(self, context: Context) -> bool:
        """Publish the next frame."""
        self.frame += 1
        if self.frame >= self.frames:
            return False
        context.publish("clock", {}, frame=self.frame, time_ns=self.frame * PERIOD_NS)
        for number, agent in enumerate(self.agents):
            context.publish("number", _number(self.frame * 10 + number), subject=agent)
        return True


class SmallAgent(SmallNode):
    """Publishes, for each number, one that depends on it and on the newest picture of an earlier frame."""

    role = "agent"
    inputs = {"clock": "clock", "number": "status", "picture": "status"}
    outputs = {"out": "status"}

    def __init__(self) -> None:
        super().__init__()
        self.pictures = {-1: 0}

    def on_clock(self, received: Received, context: Context) -> None:
        """Do nothing: its numbers tell the frame."""

    def on_number(self, received: Received, context: Context) -> None:
        """Answer with a number."""
        value = self.note("number", received)
        frame = max(frame for frame in self.pictures if frame < context.frame)
        context.publish("out", _number(value * 31 + self.pictures[frame]))

    def on_picture(self, received: Received, context: Context) -> None:
        """Keep the picture for the next frames."""
        self.pictures[received.frame] = self.note("picture", received)


class Hub(SmallNode):
    """Publishes a picture of each frame once all present agents have sent their number, or at the next clock."""

    role = "broker"
    inputs = {"clock": "clock", "out": "status"}
    outputs = {"picture": "status"}

    def __init__(self) -> None:
        super().__init__()
        self.agents: set[str] = set()
        self.values: dict[str, int] = {}

    def joined(self, node: str, role: str, context: Context) -> None:
        """Wait for another agent from now on."""
        if role == "agent":
            self.agents.add(node)

    def left(self, node: str, role: str, context: Context) -> None:
        """Wait for this agent no longer."""
        self.agents.discard(node)

    def on_clock(self, received: Received, context: Context) -> None:
        """Begin a frame."""
        self.values = {}

    def on_out(self, received: Received, context: Context) -> None:
        """Collect an agent's number."""
        self.values[received.subject] = self.note("out", received)
        if self.values.keys() >= self.agents:
            context.publish("picture", _number(sum(self.values.values()) + 7 * len(self.values)))


class SmallListener(SmallNode):
    """Publishes nothing: the driver waits for it only now and then, and at the end."""

    role = "evaluator"
    inputs = {"clock": "clock", "out": "status", "picture": "status"}

    def on_clock(self, received: Received, context: Context) -> None:
        """Do nothing."""

    def on_out(self, received: Received, context: Context) -> None:
        """Note it."""
        self.note("out", received)

    def on_picture(self, received: Received, context: Context) -> None:
        """Note it."""
        self.note("picture", received)


class SmallRelay(Node):
    """Forwards what it receives; in real time a little later.

    after_s: delay, s
    """

    role = "link"
    inputs = {"clock": "clock", "into": "status"}
    outputs = {"out": "status"}

    def __init__(self, after_s: float = 0.0) -> None:
        self.after_s = after_s

    def on_clock(self, received: Received, context: Context) -> None:
        """Do nothing: the clock sends what is delayed."""

    def on_into(self, received: Received, context: Context) -> None:
        """Forward it."""
        context.relay("out", received, after_s=self.after_s)


_AGENTS = ("a", "b")


def _wire(key: str, message: str, publisher: tuple[str, str], *subscribers: tuple[str, str], subject: str = "") -> Wire:
    return Wire(key, subject, message, (Leg(key, Endpoint(*publisher), tuple(Endpoint(*end) for end in subscribers)),))


def small_world(*, frames: int = 20, mode: str = "lockstep", steps: tuple[ProcessStep, ...] = ()) -> SimulatedWorld:
    """Five small nodes, all of whose results depend on every message: a driver, two agents, a hub and a listener.

    Agent a is restarted when it dies, the run continues without b, and it fails without the hub.
    """
    ends = [(name, "clock") for name in (*_AGENTS, "hub", "listener")]
    wires = [_wire("clock", "clock", ("ticker", "clock"), *ends)]
    for agent in _AGENTS:
        wires.append(_wire(f"number/{agent}", "status", ("ticker", "number"), (agent, "number"), subject=agent))
        out = _wire(f"agent/{agent}/out", "status", (agent, "out"), ("hub", "out"), ("listener", "out"), subject=agent)
        wires.append(out)
    pictures = [(name, "picture") for name in (*_AGENTS, "listener")]
    wires.append(_wire("picture", "status", ("hub", "picture"), *pictures))
    on_exit = {"a": "restart", "b": "continue", "listener": "continue"}
    classes: dict[str, Callable[[], Node]] = {
        "ticker": lambda: Ticker(frames, _AGENTS),
        "a": SmallAgent,
        "b": SmallAgent,
        "hub": Hub,
        "listener": SmallListener,
        "relay": lambda: SmallRelay(0.0 if mode == "lockstep" else 0.03),
    }
    roles = {"ticker": "simulator", "a": "agent", "b": "agent", "hub": "broker", "listener": "evaluator"}
    resolved = Resolved(
        name="small",
        seed=1,
        mode=mode,
        rate=1.0,
        frames=frames,
        period_ns=PERIOD_NS,
        nodes={name: NodeSpec(role, "", "", {}, on_exit.get(name, "fail")) for name, role in roles.items()},
        wiring=Wiring(tuple(wires)).to_json(),
        scene={},
        steps=steps,
        leeway_ns=0,
    )
    place = InsertionPoint("agent/a/out", "into", "out", {"clock": "clock"})
    relay = Intercept("relay", NodeSpec("link", "", "", {}, "continue"), place, ())
    return SimulatedWorld(resolved, lambda name, spec: classes[name](), (relay,))


def small_worlds(frames: int = 20) -> dict[str, SimulatedWorld]:
    """The small world in lock-step, with nodes that end and start between frames, and in real time."""
    steps = (
        ProcessStep(3, "leave", "b"),
        ProcessStep(6, "start", "b"),
        ProcessStep(9, "kill", "a"),
        ProcessStep(11, "start", "a"),
    )
    stepped = small_world(frames=frames, steps=steps)
    late = replace(stepped, resolved=replace(stepped.resolved, steps=(ProcessStep(4, "start", "listener"),)))
    return {
        "lockstep": small_world(frames=frames),
        "steps": stepped,
        "late": late,
        "realtime": small_world(frames=frames, mode="realtime"),
    }
