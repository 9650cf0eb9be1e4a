"""Whole scenarios on the simulated mesh, with everything that is sent in them, and the same in one process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

from mast_zenoh import scenario
from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.config.resolved import NodeSpec, Resolved
from mast_zenoh.control import results
from mast_zenoh.control.interception import Intercept
from mast_zenoh.messages import codec
from mast_zenoh.node import Context, Node, Overheard
from mast_zenoh.runtime.inproc import InProcess
from mast_zenoh.testing.simulation import Disturbance, Outcome, Schedule, World, play, random_schedule
from mast_zenoh.wiring.model import ANY, Wiring


class Sent(NamedTuple):
    """A message as sent: its frame, key, sequence number, and the step in which it was sent."""

    frame: int
    key: str
    seq: int
    step: int
    payload: bytes


class Memory(Node):
    """A recorder that keeps every message in memory.

    messages: in order of arrival; the list is the caller's
    """

    role = "recorder"
    inputs = {"everything": ANY}

    def __init__(self, messages: list[Sent]) -> None:
        self.messages = messages

    def on_everything(self, overheard: Overheard, context: Context) -> None:
        """Keep a message."""
        header = overheard.header
        self.messages.append(Sent(header.frame, overheard.key, header.seq, overheard.step, bytes(overheard.payload)))


class Played(NamedTuple):
    """A run: its outcome (None in one process), its messages in the order of frames, and the results of its nodes."""

    outcome: Outcome | None
    messages: list[Sent]
    results: dict[str, Any]

    def without(self, *keys: str) -> list[Sent]:
        """The messages on all keys that contain none of these texts."""
        return [message for message in self.messages if not any(key in message.key for key in keys)]

    def frames(self, key: str) -> list[int]:
        """The frames of the messages on a key."""
        return [message.frame for message in self.messages if message.key == key]


def resolve(name: str, *settings: str, steps: Iterable[tuple[int, str, str]] = (), **options: Any) -> Resolved:
    """A scenario that is not recorded; steps: its process steps, instead of its own if there are any."""
    path, loaded = scenario.load(name, settings)
    resolved = scenario.resolve(path, loaded, **options)
    own = tuple(ProcessStep(*step) for step in steps)
    return replace(resolved, steps=own) if own else resolved


def simulated(resolved: Resolved, schedule: Schedule, requests: tuple[Intercept, ...] = ()) -> Played:
    """The run on the simulated mesh, with a recorder."""
    messages: list[Sent] = []
    world = World.of(resolved, requests)
    wiring = Wiring.from_json(resolved.wiring)
    overheard = replace(wiring, overhearers=(*wiring.overhearers, Memory.endpoint())) if False else wiring
    recorder = NodeSpec("recorder", "", "", {}, "continue")
    recorded = replace(resolved, nodes={**resolved.nodes, "recorder": recorder}, wiring=overheard.to_json())
    build = world.build
    world = replace(
        world,
        resolved=recorded,
        build=lambda name, spec: Memory(messages) if name == "recorder" else build(name, spec),
    )
    outcome = play(world, schedule)
    outcome.results.pop("recorder", None)
    return Played(outcome, sorted(messages), _packed(outcome.results))
