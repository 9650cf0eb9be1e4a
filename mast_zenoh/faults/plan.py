"""From the faults of a scenario to what is done: rules of links, steps of processes, and the bands of the timeline."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Ints
from mast_zenoh.config.process_steps import REALTIME, UNDONE_BY, ProcessStep
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.faults import targets
from mast_zenoh.faults.base import DIRECTIONS, Fault, Rule
from mast_zenoh.streams import stream

#: What becomes of a node by an action: the states that it may be in, and the one it is in afterwards.
_BECOMES = {
    "start": (("absent", "down"), "up"),
    "kill": (("up",), "down"),
    "leave": (("up",), "down"),
    "pause": (("up",), "paused"),
    "resume": (("paused",), "up"),
    "disconnect": (("up",), "cut off"),
    "connect": (("cut off",), "up"),
}
_NAMES_SHOWN = 3


@dataclass
class Plan:
    """What the faults of a run come to.

    rules: by agent and direction, the rules of its link with their times, in the order of the faults
    steps: what happens to processes, by frame
    bands: a plain dict of label, kind, type, at_s, until_s, nodes and backend for every fault that the run gets to
    missed: places of faults that begin after the last frame
    """

    rules: dict[str, dict[str, list[Rule]]] = field(default_factory=dict)
    steps: tuple[ProcessStep, ...] = ()
    bands: list[dict[str, Any]] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)


def frame_at(times_ns: Ints, at_s: float) -> int:
    """The first frame whose time is not before `at_s`; the number of frames if there is none."""
    return int(np.searchsorted(times_ns, round(at_s * 1e9), side="left"))


def plan(
    faults: Sequence[tuple[str, Fault]],
    roles: Mapping[str, str],
    times_ns: Ints,
    seed: int,
    *,
    lockstep: bool,
) -> Plan:
    """What a list of faults comes to.

    faults: (where it stands in the scenario, the fault), in the order written
    roles:  role of every node of the run, but for the links that the faults themselves make necessary
    times_ns: (frames,) ns since the scene began, of the frames that are played

    Raises ConfigurationError for targets that there are not or that cannot be hit, for what cannot happen to a
    process (killed while it is down, two things at one frame), and in lock-step for what is for real time only.
    """
    found = Plan()
    happenings: dict[str, list[_Happening]] = defaultdict(list)
    for index, (place, fault) in enumerate(faults):
        rng = stream(seed, "faults", index, "targets")
        where = f"{place}.{'node' if fault.node is not None else 'nodes'}"
        rules = fault.rules(lockstep)
        events = fault.events()
        if lockstep and not rules and any(action in REALTIME for _, action in events):
            raise ConfigurationError(
                f"{place}: {type(fault).__name__}: in lock-step everybody would wait for who is stopped or cut off; "
                "use Partition, which does this with links, or real time (mode realtime)"
            )
        nodes = targets.processes(fault.aims, roles, rng, where) if events else []
        begins = frame_at(times_ns, fault.at) < len(times_ns)
        if rules:
            ways = {role: fault.ways(role) for role in roles.values()}
            aims = nodes or fault.aims
            agents = targets.links(aims, roles, ways, rng, where)
            nodes = nodes or list(agents)
            for agent, directions in agents.items():
                of_agent = found.rules.setdefault(agent, {way: [] for way in DIRECTIONS})
                for way in directions:
                    of_agent[way] += [{**rule, "at": fault.at, "until": fault.over} for rule in rules]
        for name in nodes if events else ():
            happenings[name] += [_Happening(at_s, action, place, not rules) for at_s, action in events]
        if begins:
            found.bands.append(_band(fault, nodes, "links" if rules else "process", times_ns))
        else:
            found.missed.append(place)
    found.steps = tuple(sorted(step for name in happenings for step in _steps(name, happenings[name], times_ns)))
    return found


@dataclass
class _Happening:
    """An action on one node; `acts`: on its process, not through its link."""

    at_s: float
    action: str
    place: str
    acts: bool


def _steps(name: str, happenings: list[_Happening], times_ns: Ints) -> list[ProcessStep]:
    """The steps of one node, checked to follow from each other."""
    happenings = sorted(happenings, key=lambda happening: happening.at_s)  # stable: as written, within one time
    state = "absent" if happenings[0].action == "start" else "up"
    steps: list[ProcessStep] = []
    last, before = -1, ""
    for happening in happenings:
        allowed, becomes = _BECOMES[happening.action]
        if state not in allowed:
            past = "it has not joined yet" if state == "absent" else f"it is {state}"
            raise ConfigurationError(
                f"{happening.place}: {happening.action} of {name!r} at {happening.at_s:g} s: {past} then"
                + (f" (see {before})" if before else "")
            )
        frame = frame_at(times_ns, happening.at_s)
        if frame == last < len(times_ns) and happening.place == before:
            frame += 1  # down, paused or cut off for one frame at least
        elif frame <= last and frame < len(times_ns):
            raise ConfigurationError(
                f"{happening.place}: {happening.action} of {name!r} at {happening.at_s:g} s: something else happens "
                f"to it before the same frame (see {before})"
            )
        state, last, before = becomes, frame, happening.place
        if happening.acts:
            steps.append(ProcessStep(frame, happening.action, name))
    return _within(steps, len(times_ns))


def _within(steps: list[ProcessStep], frames: int) -> list[ProcessStep]:
    """Those that happen before the end of the run; a pause or cut that would outlast it ends before the last frame."""
    inside = [step for step in steps if step.frame < frames]
    if not inside or inside[-1].action not in UNDONE_BY:
        return inside
    last = inside[-1]
    if last.frame >= frames - 1:
        return inside[:-1]
    return [*inside, ProcessStep(frames - 1, UNDONE_BY[last.action], last.node)]


def _band(fault: Fault, nodes: Sequence[str], backend: str, times_ns: Ints) -> dict[str, Any]:
    """A fault on the timeline. Who joins late is missing from the beginning on; what outlasts the run has no end."""
    over = fault.over
    if over is not None and frame_at(times_ns, over) >= len(times_ns):
        over = None
    joins = [action for _, action in fault.events()] == ["start"]
    kind = type(fault).__name__
    shown = ", ".join(nodes) if len(nodes) <= _NAMES_SHOWN else f"{len(nodes)} nodes"
    return {
        "label": f"{kind} {shown}",
        "kind": "fault",
        "type": kind,
        "at_s": 0.0 if joins else fault.at,
        "until_s": over,
        "nodes": list(nodes),
        "backend": backend,
    }
