"""What is simulated: a scenario, its nodes, requests to insert more of them; and schedules that disturb it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from random import Random
from typing import Any, NamedTuple

from mast_zenoh.config.resolved import NodeSpec, Resolved, build_node, has_topics_outside
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.launch import live_interception
from mast_zenoh.mesh.control.interception import Intercept
from mast_zenoh.messages import user_types
from mast_zenoh.node import Node


@dataclass(frozen=True, eq=False)
class SimulatedWorld:
    """A scenario to simulate.

    build:    builds a node from its name and its entry in the scenario; called again when a process starts again
    requests: nodes that a schedule may insert while the run is going
    start_s:  how long a process takes from its start until it joins, s
    """

    resolved: Resolved
    build: Callable[[str, NodeSpec], Node]
    requests: tuple[Intercept, ...] = ()
    start_s: float = 0.01

    @classmethod
    def of(cls, resolved: Resolved, requests: Iterable[Intercept | Mapping[str, Any]] = ()) -> SimulatedWorld:
        """The world of a resolved scenario, with its own nodes.

        requests: nodes that a schedule may insert; as dicts with the parameters of `mast intercept`: wire, file, name,
                  and perhaps input, output, settings. Raises what that raises
        """
        user_types.use(resolved.messages)
        resolved.load_modules()
        for name, spec in resolved.nodes.items():
            if has_topics_outside(spec):
                raise ConfigurationError(
                    f"{name}: {spec.type} exchanges messages with programs outside the run, which a simulated mesh "
                    "does not have: expected nodes without; test such a node by testing.scenarios.FakeLink"
                )
        planned: list[Intercept] = []
        for request in requests:
            if isinstance(request, Mapping):
                request = Intercept(*live_interception.plan(resolved, **request), ())
            if not isinstance(request, Intercept):
                raise ConfigurationError(f"requests: found {request!r:.60}, expected dicts with wire, file and name")
            planned.append(request)
        return cls(resolved, lambda name, spec: build_node(spec, name), tuple(planned))


#: Kinds of disturbances, with what they do. Of those in `HARMLESS`, an exact run must not even take notice.
KINDS = {
    "suspend": "suspends a process for some seconds",
    "freeze": "suspends a process for longer than the driver waits",
    "suspend launcher": "suspends the launcher for some seconds",
    "cut": "cuts a node's link for some seconds",
    "intercept": "asks the launcher to insert a node into a wire",
    "release": "asks the launcher to release it",
    "kill": "kills a process",
    "kill at stop": "kills a process some time after it was told to finish",
    "fill": "lets a process keep only a few messages in its inbox from then on",
    "interrupt": "sends the launcher a stop signal",
    "lose launcher": "kills the launcher",
}
HARMLESS = frozenset({"suspend", "suspend launcher", "cut", "intercept", "release"})
_OF_LAUNCHER = frozenset({"suspend launcher", "interrupt", "lose launcher"})
_WAITS = frozenset({"suspend", "suspend launcher", "cut"})

_LONGEST_STOP_S = 8.0
_PATIENCE_S = 3 * _LONGEST_STOP_S  # shorter than the time after which the driver gives up
_FREEZE_S = 45.0
# How often each kind is drawn. In real time, only insertions leave a run so sound that losses can be seen.
_LOCKSTEP, _REALTIME = (3, 1, 2, 2, 4, 3, 6, 4, 3, 1, 1), (2, 1, 1, 1, 3, 12, 2, 1, 1, 1, 1)


class Disturbance(NamedTuple):
    """One disturbance; at_s: virtual time since the launcher started; lasts_s: for some kinds."""

    at_s: float
    kind: str
    node: str = ""
    lasts_s: float = 0.0

    def __str__(self) -> str:
        lasts = f" for {self.lasts_s:g} s" if self.lasts_s else ""
        return f"{self.at_s:.4f} s: {self.kind}{f' {self.node}' if self.node else ''}{lasts}"


@dataclass(frozen=True)
class Schedule:
    """All that decides how a world is played.

    seed:  of all delays;  calm: whether all of them are equal
    loss:  share of lost messages of wires, and of duplicated ones; only in real time

    Raises ConfigurationError for a kind that does not exist, and a time or share that is not possible.
    """

    seed: int
    disturbances: tuple[Disturbance, ...] = ()
    calm: bool = False
    loss: float = 0.0

    def __post_init__(self) -> None:
        for number, disturbance in enumerate(self.disturbances):
            place = f"schedule: disturbances[{number}]"
            if not isinstance(disturbance, Disturbance):
                raise ConfigurationError(f"{place}: found {disturbance!r}, expected a Disturbance")
            at_s, kind, _, lasts_s = disturbance
            if kind not in KINDS:
                raise ConfigurationError(f"{place}: unknown kind {kind!r}{nearest(str(kind), KINDS)}")
            if not (0.0 <= at_s < math.inf and 0.0 <= lasts_s < math.inf):
                raise ConfigurationError(f"{place}: found {at_s} s for {lasts_s} s, expected finite times from 0 on")
        if not 0.0 <= self.loss <= 0.5:
            raise ConfigurationError(f"schedule: loss: found {self.loss}, expected 0 to 0.5")

    def check(self, world: SimulatedWorld) -> None:
        """Raise ConfigurationError for a node that a world does not have; a release may name any: it is refused."""
        for number, (_, kind, node, _) in enumerate(self.disturbances):
            inserted = [request.name for request in world.requests]
            known = inserted if kind == "intercept" else [*world.resolved.nodes, *inserted]
            place = f"schedule: disturbances[{number}]: {kind}"
            if kind in _OF_LAUNCHER and node:
                raise ConfigurationError(f"{place}: found the node {node!r}, expected none")
            if kind not in {*_OF_LAUNCHER, "release"} and node not in known:
                raise ConfigurationError(f"{place}: unknown node {node!r}{nearest(str(node), known)}")

    @property
    def harmless(self) -> bool:
        """Whether a run in lock-step must be as if nothing had happened."""
        return not self.freezes and all(disturbance.kind in HARMLESS for disturbance in self.disturbances)

    @property
    def freezes(self) -> bool:
        """Whether processes may be suspended, or cut off, for longer than the driver waits."""
        waits_s = sum(disturbance.lasts_s for disturbance in self.disturbances if disturbance.kind in _WAITS)
        return waits_s > _PATIENCE_S or any(disturbance.kind == "freeze" for disturbance in self.disturbances)

    def simpler(self) -> list[Schedule]:
        """Schedules with less, to find out what matters."""
        disturbances = self.disturbances
        fewer = [replace(self, disturbances=disturbances[:i] + disturbances[i + 1 :]) for i in range(len(disturbances))]
        return [
            *fewer,
            *([] if self.calm else [replace(self, calm=True)]),
            *([replace(self, loss=0.0)] * (self.loss > 0)),
        ]

    def __str__(self) -> str:
        delays = "equal delays" if self.calm else f"delays of seed {self.seed}"
        lost = f", {self.loss:.0%} of messages lost" if self.loss else ""
        return "\n".join([delays + lost, *map(str, self.disturbances)])


def random_schedule(seed: int, world: SimulatedWorld) -> Schedule:
    """A schedule for a world: none or some disturbances, most of them while frames are played."""
    random = Random(seed)
    names = list(world.resolved.nodes)
    restarted = [name for name, spec in world.resolved.nodes.items() if spec.on_exit == "restart"]
    realtime = world.resolved.mode == "realtime"
    disturbances = []
    for _ in range(random.choice((0, 1, 1, 2, 3))):
        kind = random.choices(list(KINDS), _REALTIME if realtime else _LOCKSTEP)[0]
        # Most runs take some tenths of a second of virtual time; the first of them are worth more attempts.
        at_s = random.choice(
            (random.uniform(0.0, 0.15), random.expovariate(4.0), 2 * world.start_s + 0.05 * random.random())
        )
        if kind in ("intercept", "release"):
            if world.requests:
                name = random.choice([request.name for request in world.requests])
                disturbances.append(Disturbance(at_s, "intercept", name))
                if kind == "release":
                    disturbances.append(Disturbance(at_s + random.uniform(0.02, 0.25), "release", name))
                if random.random() < (0.1 if realtime else 0.5):  # another process starts or ends beside it
                    node = random.choice([*names, name, *restarted, *restarted])
                    disturbances.append(Disturbance(max(0.0, at_s + random.uniform(-0.03, 0.05)), "kill", node))
        elif kind == "cut":
            disturbances.append(Disturbance(at_s, kind, random.choice(names), round(random.uniform(0.05, 4.0), 3)))
        elif kind == "freeze":
            disturbances.append(Disturbance(at_s, kind, random.choice(names), _FREEZE_S))
        elif kind in ("suspend", "suspend launcher"):
            long = kind == "suspend launcher" or random.random() < 0.2
            lasts_s = round(random.uniform(0.05, _LONGEST_STOP_S if long else 1.0), 3)
            disturbances.append(Disturbance(at_s, kind, random.choice(names) if kind == "suspend" else "", lasts_s))
        elif kind == "kill at stop":
            disturbances.append(Disturbance(0.0, kind, random.choice(names), round(random.expovariate(500.0), 5)))
        elif kind == "fill":
            node = random.choice(names)
            disturbances.append(Disturbance(at_s, kind, node))
            if random.random() < 0.7:  # it falls behind
                disturbances.append(Disturbance(at_s, "suspend", node, 0.5))
        else:
            disturbances.append(Disturbance(at_s, kind, random.choice(names) if kind == "kill" else ""))
    loss = random.choice((0.0, 0.0, 0.0, 0.05)) if realtime else 0.0
    return Schedule(seed, tuple(sorted(disturbances)), calm=realtime and random.random() < 0.5, loss=loss)
