"""Whole scenarios on the simulated mesh, with every message that is sent in them, and the same in one process."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import count, islice
from typing import Any, NamedTuple

from mast_zenoh import scenario
from mast_zenoh.config.resolved import ProcessStep, Resolved
from mast_zenoh.mesh.control import results
from mast_zenoh.mesh.control.interception import Intercept
from mast_zenoh.mesh.host import Outgoing
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages import codec
from mast_zenoh.node import Context, Node, Overheard, Received
from mast_zenoh.testing.simulation import (
    Disturbance,
    Schedule,
    SimulatedWorld,
    SimulationOutcome,
    play,
    random_schedule,
)
from mast_zenoh.wiring.model import ANY, Wiring

RECORDER = "recorder"

#: Process steps one after the other, and two at once; some nodes return, one joins late, one never returns.
CHURN = (
    (2, "start", "infra_3"),
    (3, "kill", "infra_1"),
    (5, "start", "infra_1"),
    (6, "kill", "adversary_1"),
    (6, "kill", "command_center"),
    (8, "kill", "broker"),
    (8, "start", "command_center"),
    (10, "start", "adversary_1"),
    (10, "start", "broker"),
    (11, "leave", "ego"),
    (12, "kill", "infra_2"),
    (13, "start", "ego"),
)


class Listener(Node):
    """Returns the number and the frame of each message that it hears, by agent."""

    role = "evaluator"
    inputs = {"clock": "clock", "out": "status", "picture": "status"}

    def __init__(self) -> None:
        self.heard: dict[str, list[tuple[int, int]]] = {}

    def on_clock(self, received: Received, context: Context) -> None: ...

    def on_out(self, received: Received, context: Context) -> None:
        self.heard.setdefault(received.subject, []).append((received.message.header.seq, received.frame))

    def on_picture(self, received: Received, context: Context) -> None: ...

    def finish(self, context: Context) -> dict[str, Any]:
        return {"heard": self.heard}


def listening(world: SimulatedWorld) -> SimulatedWorld:
    """The same run, with a listener that returns what it heard."""
    build = world.build
    return replace(world, build=lambda name, spec: Listener() if name == "listener" else build(name, spec))


class Sent(NamedTuple):
    """A message as it was sent; step: the run's frame then."""

    frame: int
    key: str
    seq: int
    step: int
    payload: bytes


class Memory(Node):
    """A recorder that keeps every message.

    messages: in order of arrival
    """

    role = RECORDER
    inputs = {"everything": ANY}

    def __init__(self, messages: list[Sent]) -> None:
        self.messages = messages

    def on_everything(self, overheard: Overheard, context: Context) -> None:
        """Keep a message."""
        header = overheard.header
        self.messages.append(Sent(header.frame, overheard.key, header.seq, overheard.step, overheard.payload))


class Played(NamedTuple):
    """The messages of a run by frame, key and number, and what its nodes handed in, packed."""

    messages: list[Sent]
    results: dict[str, bytes]

    def frames(self, key: str) -> list[int]:
        """The frames of the messages on a key."""
        return [message.frame for message in self.messages if message.key == key]

    def without_taps(self) -> list[Sent]:
        """The messages that subscribers receive."""
        return [message for message in self.messages if "@tap" not in message.key]


def resolve(
    name: str, *settings: str, steps: Iterable[tuple[int, str, str]] = (), recorded: bool = True, **options: Any
) -> Resolved:
    """A scenario.

    steps: replace its process steps, if there are any;  recorded: whether it has a recorder
    """
    resolved = scenario.resolve(*scenario.load(name, settings), record=recorded, **options)
    own = tuple(ProcessStep(*step) for step in steps)
    return replace(resolved, steps=own) if own else resolved


def on_simulated_mesh(
    resolved: Resolved, schedule: Schedule, requests: tuple[Intercept, ...] = ()
) -> tuple[Played, SimulationOutcome]:
    """Play a scenario with a schedule."""
    messages: list[Sent] = []
    world = SimulatedWorld.of(resolved, requests)
    build = world.build
    recorded = replace(world, build=lambda name, spec: Memory(messages) if name == RECORDER else build(name, spec))
    outcome = play(recorded, schedule)
    return Played(sorted(messages), _packed(outcome.results)), outcome


def in_one_process(resolved: Resolved) -> Played:
    """Play it in one process, in order."""
    wiring = Wiring.from_json(resolved.wiring)
    heard = tuple(end for end in wiring.overhearers if end.node != RECORDER)
    nodes = {name: spec for name, spec in resolved.nodes.items() if name != RECORDER}
    alone = replace(resolved, nodes=nodes, wiring=replace(wiring, overhearers=heard).to_json())
    types = {leg.key: wire.message for wire, leg in wiring.legs()}
    messages: list[Sent] = []

    def tap(sent: Outgoing) -> None:
        assert isinstance(sent.payload, bytes)
        header = codec.decode_header(sent.payload, types[sent.key])
        messages.append(Sent(header.frame, sent.key, header.seq, sent.step, sent.payload))

    of_nodes = InProcess(alone, encode=True, tap=tap).run()
    return Played(sorted(messages), _packed(of_nodes))


def harmless_schedules(resolved: Resolved, number: int) -> Iterator[Schedule]:
    """Schedules of different seeds that an exact run must not notice: stopped processes, cut links, a stopped launcher.

    The first has delays only.
    """
    world = SimulatedWorld(resolved, lambda name, spec: Memory([]))
    drawn = (random_schedule(seed, world) for seed in count(1))
    harmless = (schedule for schedule in drawn if schedule.harmless and schedule.disturbances)
    yield Schedule(0)
    yield from islice(harmless, number - 1)


def schedule(seed: int, *disturbances: tuple[Any, ...], calm: bool = False) -> Schedule:
    """A schedule; disturbances: time in s, kind, node, how long it lasts in s."""
    return Schedule(seed, tuple(Disturbance(*disturbance) for disturbance in disturbances), calm)


def assert_equals_one_process(resolved: Resolved, *schedules: Schedule) -> Played:
    """Play a scenario; assert that it ends well, and that every message and result is the same as in one process."""
    expected = in_one_process(resolved)
    for schedule in schedules or harmless_schedules(resolved, 2):
        played, outcome = on_simulated_mesh(resolved, schedule)
        assert outcome.claims_to_be_exact(), (
            f"{outcome.error} {outcome.lost} {outcome.churn} {outcome.rejected}\n{schedule}"
        )
        assert outcome.violations == []
        assert_same_messages(played.messages, expected.messages, str(schedule))
        different = [name for name, packed in expected.results.items() if played.results.get(name) != packed]
        assert not different, f"different results of {different}\n{schedule}"
    return expected


def assert_same_messages(found: list[Sent], expected: list[Sent], what: str = "") -> None:
    """Assert that two runs have the same messages; name the first that differs."""
    for one, other in zip(found, expected, strict=False):
        assert one[:4] == other[:4], what
        assert one.payload == other.payload, f"{one[:4]}: {what}"
    assert len(found) == len(expected) > 0, what


def _packed(of_nodes: dict[str, Any]) -> dict[str, bytes]:
    """Results without those of the run itself and of the recorder."""
    return {name: results.pack(_ordered(value)) for name, value in of_nodes.items() if name not in ("", RECORDER)}


def _ordered(value: Any) -> Any:
    """A value with all maps in the order of their keys."""
    if isinstance(value, dict):
        return {key: _ordered(value[key]) for key in sorted(value)}
    return [_ordered(item) for item in value] if isinstance(value, list | tuple) else value
