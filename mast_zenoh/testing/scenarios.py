"""Checks nodes and whole scenarios.

A link to programs outside the run that are functions: for tests of nodes with `outside_topics`.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mast_zenoh import scenario as scenarios
from mast_zenoh.api.runs import Scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.control.failures import lines
from mast_zenoh.mesh.host import Outgoing
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import BUILT_IN, Schema
from mast_zenoh.node import Node, check_handlers
from mast_zenoh.outside import Arrival
from mast_zenoh.run_folder.recording.difference import compare, explain
from mast_zenoh.testing import simulation
from mast_zenoh.testing.comparison import expect, first_difference
from mast_zenoh.wiring.model import ANY

_ORDERS = 3  #: number of random orders of delivery


def check_node(node: type[Node], *message_types: Schema) -> None:
    """Check a node class: its role, a handler per input, and known message types.

    message_types: types from other files that it uses by name. `check_scenario` checks what the node does.
    """
    names = BUILT_IN.keys() | node.message_types.keys() | {schema.name for schema in message_types}
    expect(node.role, f"{node.__name__}.role: found nothing, expected the name of a role")
    for ports in ("inputs", "outputs"):
        for port, message in getattr(node, ports).items():
            known = message in names or (ports == "inputs" and message == ANY)
            expect(known, f"{node.__name__}.{ports}[{port!r}]: there is no message type {message!r}")
    try:
        check_handlers(node)
    except TypeError as error:
        raise AssertionError(str(error)) from error


def check_scenario(
    scenario: Scenario, *, frames: int = 20, seed: int = 0, mesh: bool = False, schedules: int = 0, **parameters: Any
) -> None:
    """Check that neither the order of delivery nor the runtime affects a scenario.

    scenario, parameters: as for `mast_zenoh.run`
    frames, seed:         number of frames, and the seed of all random draws
    mesh:                 also run it with a process for each node, which takes a few seconds
    schedules:            number of simulated runs, in the scenario's own mode, in which processes are suspended and
                          killed, links cut and messages delayed, each time at other moments: seeds 0, 1, … of
                          `testing.simulation`

    Messages and results must be the same whether nodes share messages or get copies, and for any order of delivery.
    This detects nodes that change their inputs or depend on the order of messages.
    Raises AssertionError if they differ, and MastError for a scenario that cannot run.
    """
    if not isinstance(schedules, int) or schedules < 0:
        raise ConfigurationError(f"schedules: found {schedules!r}, expected a whole number from 0 on")
    path, content = scenarios.load_values(scenario, parameters)
    resolved = scenarios.resolve(path, content, frames=frames, seed=seed, mode="lockstep")
    first = _played(resolved, encode=True)
    _expect_equal(_played(resolved, encode=False), first, "when nodes share arrays: does one change its inputs?")
    for order in range(_ORDERS):
        _expect_equal(_played(resolved, encode=True, shuffle=order), first, "in another order of delivery")
    if schedules:
        _check_simulated(scenarios.resolve(path, content, frames=frames, seed=seed), first, schedules)
    if mesh:
        recorded = scenarios.resolve(path, content, frames=frames, seed=seed, mode="lockstep", record=True)
        _check_mesh(recorded)


class _Played(NamedTuple):
    """All messages by key, and the results of each node."""

    messages: dict[str, list[bytes]]
    results: dict[str, dict[str, Any]]


def _played(resolved: Resolved, *, encode: bool, shuffle: int | None = None) -> _Played:
    messages: dict[str, list[bytes]] = defaultdict(list)

    def tap(sent: Outgoing) -> None:
        payload = sent.payload
        messages[sent.key].append(payload if isinstance(payload, bytes) else codec.encode(payload))

    process = InProcess(resolved, encode=encode, shuffle=shuffle, tap=tap)
    outcome = process.run()
    del outcome[""]
    expect(not process.failures(), "a handler failed: " + "; ".join(lines(process.failures())))
    return _Played(messages, outcome)


def _expect_equal(actual: _Played, first: _Played, when: str) -> None:
    for key in sorted(first.messages.keys() | actual.messages.keys()):
        expect(first.messages.get(key) == actual.messages.get(key), f"{key}: messages differ {when}")
    difference = first_difference(actual.results, first.results)
    expect(not difference, f"results of nodes differ {when}: {difference}")


def _check_simulated(resolved: Resolved, first: _Played, schedules: int) -> None:
    world = simulation.SimulatedWorld.of(resolved)
    if resolved.mode == "lockstep":
        outcome = simulation.undisturbed(world)
        streams = {key: hashlib.sha256(b"".join(messages)).digest() for key, messages in first.messages.items()}
        for key in sorted(streams.keys() | outcome.streams.keys()):
            expect(streams.get(key) == outcome.streams.get(key), f"{key}: messages differ on the simulated mesh")
        by_name = {name: outcome.results.get(name, {}) for name in first.results}
        difference = first_difference(by_name, first.results)
        expect(not difference, f"results of nodes differ on the simulated mesh: {difference}")
    simulation.explore(world, range(schedules))


def _check_mesh(resolved: Resolved) -> None:
    with tempfile.TemporaryDirectory(prefix="mast-check-") as folder:
        here = launcher.run(resolved, Path(folder) / "here", runtime="inproc")
        there = launcher.run(resolved, Path(folder) / "there", runtime="mesh")
        for run in (here, there):
            if run.error is not None:
                raise run.error
        difference = compare(here.folder, there.folder, taps=True)
        expect(difference.first is None, "the mesh differs from one process:\n" + "\n".join(explain(difference)))


#: What a program outside answers to a message: (topic, message) of each answer, in order.
Program = Callable[[str, Any], Iterable[tuple[str, Any]]]


class FakeLink:
    """A link to one program, which answers at once, and is always there.

    program: called with the topic and the content of each message that the node sends
    waits: whether the run waits for answers, as in lock-step
    sent: the messages of the node, as (topic, message);  announced: their types by topic
    waited_s: the limits of the waits that were in vain, s
    clock_arrivals_ns, refused: see `Outside`
    """

    def __init__(self, program: Program = lambda topic, message: (), *, waits: bool = True) -> None:
        self.waits = waits
        self.ended = False
        self.announced: dict[str, str] = {}
        self.sent: list[tuple[str, Any]] = []
        self.waited_s: list[float] = []
        self.clock_arrivals_ns: dict[int, int] = {}
        self.refused: Mapping[str, int] = Counter()
        self.program = program
        self._arrivals: list[Arrival] = []

    def announce(self, topic: str, type_name: str) -> None:
        self.announced[topic] = type_name

    def send(self, topic: str, message: Any) -> None:
        assert topic in self.announced, f"{topic}: not announced"
        self.sent.append((topic, message))
        for answer in self.program(topic, message):
            self.arrive(*answer)

    def arrive(self, topic: str, message: Any, publisher: bytes = bytes(16)) -> None:
        """Let a message from outside arrive. publisher: its id"""
        self._arrivals.append(Arrival(topic, message, publisher))

    def take(self) -> list[Arrival]:
        arrivals, self._arrivals = self._arrivals, []
        return arrivals

    def wait(self, limit_s: float, done: Callable[[], bool], needed: Sequence[str] = ()) -> bool:
        if done():
            return True
        self.waited_s.append(limit_s)
        return False

    def present(self, topic: str) -> bool:
        return True

    def heard(self, topic: str) -> bool:
        return True

    def absence(self, topic: str) -> str:
        return ""

    def note_clock(self, frame: int) -> None:
        self.clock_arrivals_ns.setdefault(frame, frame)

    def end(self) -> None:
        self.ended = True

    def close(self) -> None:
        pass
