"""Faults as link rules, process steps and bands of the timeline; random lists of them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import numpy as np

from mast_zenoh import links
from mast_zenoh.arrays.states import Ints
from mast_zenoh.config import registry
from mast_zenoh.config.resolved import REALTIME, UNDONE_BY, ProcessStep
from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.faults.base import DIRECTIONS, SENSOR, Fault, Impair, Rule
from mast_zenoh.streams import stream

#: For each action on a node, the states in which it is allowed, and the resulting state.
_TRANSITIONS = {
    "start": (("absent", "down"), "up"),
    "kill": (("up",), "down"),
    "leave": (("up",), "down"),
    "pause": (("up",), "paused"),
    "resume": (("paused",), "up"),
    "disconnect": (("up",), "cut off"),
    "connect": (("cut off",), "up"),
}
_MAX_NAMES = 3

#: By key of a wire, where a fault of it acts: (link, direction), the link named after its agent; (agent, SENSOR) or
#: (agent, SENSOR/name) before its sensors; (the key, "up") on a link that the wire gets for the fault.
Carriers = Mapping[str, Sequence[tuple[str, str]]]


@dataclass
class FaultPlan:
    """The effects of a run's faults.

    rules: by link (its agent, or the key of its wire) and direction (or SENSOR, SENSOR/name), its rules with their
        times, in the order of the faults
    steps: actions on processes, by frame
    bands: a plain dict of label, kind, type, at_s, until_s, nodes and backend for every fault that begins in the run
    missed: places of faults that begin after the last frame
    of_agents: type, beginning and end in s (None: of the run) of the faults of what each agent sends
    """

    rules: dict[str, dict[str, list[Rule]]] = field(default_factory=dict)
    steps: tuple[ProcessStep, ...] = ()
    bands: list[dict[str, Any]] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    of_agents: dict[str, list[tuple[str, float, float | None]]] = field(default_factory=dict)


def frame_at(times_ns: Ints, at_s: float) -> int:
    """The first frame at or after `at_s`; the number of frames if there is none."""
    return int(np.searchsorted(times_ns, round(at_s * 1e9), side="left"))


def plan(
    faults: Sequence[tuple[str, Fault]],
    roles: Mapping[str, str],
    times_ns: Ints,
    seed: int,
    *,
    lockstep: bool,
    carriers: Callable[[], Carriers] = dict,
) -> FaultPlan:
    """Convert a list of faults to a plan.

    faults: (place in the scenario, fault), in the order of the scenario
    roles:  role of every node of the run, except the links that the faults themselves require
    times_ns: (frames,) ns since the start of the scene, of the frames that are played
    carriers: returns where a fault of a wire acts; called if a target may be the key of one

    Raises ConfigurationError for unknown or invalid targets, for impossible actions on a process (killed while it is
    down, two actions in the same frame), and in lock-step for faults that need real time.
    """
    result = FaultPlan()
    actions: dict[str, list[_Action]] = defaultdict(list)
    for index, (place, fault) in enumerate(faults):
        if not fault.selectors:  # an empty list: of nothing
            continue
        where = f"{place}.{fault.target_parameter}"
        rules = [{**rule, "at": fault.at, "until": fault.over} for rule in fault.rules(lockstep)]
        events = fault.events()
        if lockstep and not rules and any(action in REALTIME for _, action in events):
            raise ConfigurationError(
                f"{place}: {type(fault).__name__}: in lock-step all nodes would wait for a stopped or disconnected "
                "one; use Partition, which acts on links, or real time (mode realtime)"
            )
        draws = partial(stream, seed, "faults", index, "targets")  # the same for every rule
        nodes = processes(fault.selectors, roles, draws(), where) if events else []
        impaired = [] if rules else [name for name in nodes if roles[name] == "agent"]
        affected: list[str] = []
        for number, rule in enumerate(rules):
            which = f"[{number}]" if len(rules) > 1 else ""
            of_rule = f"{place}.rule{which}" if isinstance(fault, Impair) else place
            of_sensor = registry.build(rule, links.Rule, of_rule).needs_detections
            ways = {role: (SENSOR,) * (role == "agent") if of_sensor else fault.ways(role) for role in roles.values()}
            for link, directions in links_of(nodes or fault.selectors, roles, ways, draws(), where, carriers).items():
                of_link = result.rules.setdefault(link, {way: [] for way in DIRECTIONS})
                for way in directions:
                    of_link.setdefault(way, []).append(rule)
                affected.append(link)
                impaired += [link] if link in roles and directions != ["down"] else []
        for name in nodes:
            actions[name] += [_Action(at_s, action, place, not rules) for at_s, action in events]
        if frame_at(times_ns, fault.at) < len(times_ns):
            shown = _band(fault, nodes or [*dict.fromkeys(affected)], "links" if rules else "process", times_ns)
            result.bands.append(shown)
            kind = ", ".join(str(rule["type"]) for rule in rules) if isinstance(fault, Impair) else shown["type"]
            for agent in dict.fromkeys(impaired):
                result.of_agents.setdefault(agent, []).append((kind, shown["at_s"], shown["until_s"]))
        else:
            result.missed.append(place)
    result.steps = tuple(sorted(step for name in actions for step in _steps(name, actions[name], times_ns)))
    return result


@dataclass
class _Action:
    """An action on one node; `acts`: on its process instead of its link."""

    at_s: float
    action: str
    place: str
    acts: bool


def _steps(name: str, actions: list[_Action], times_ns: Ints) -> list[ProcessStep]:
    """The steps of one node, validated as a sequence."""
    actions = sorted(
        actions, key=lambda action: action.at_s
    )  # stable: simultaneous actions keep the order of the scenario
    state = "absent" if actions[0].action == "start" else "up"
    steps: list[ProcessStep] = []
    last, before = -1, ""
    for action in actions:
        allowed, new_state = _TRANSITIONS[action.action]
        if state not in allowed:
            reason = "it has not joined yet" if state == "absent" else f"it is {state}"
            raise ConfigurationError(
                f"{action.place}: {action.action} of {name!r} at {action.at_s:g} s: {reason} then"
                + (f" (see {before})" if before else "")
            )
        frame = frame_at(times_ns, action.at_s)
        if frame == last < len(times_ns) and action.place == before:
            frame += 1  # down, paused or cut off for one frame at least
        elif frame <= last and frame < len(times_ns):
            raise ConfigurationError(
                f"{action.place}: {action.action} of {name!r} at {action.at_s:g} s: another action "
                f"applies before the same frame (see {before})"
            )
        state, last, before = new_state, frame, action.place
        if action.acts:
            steps.append(ProcessStep(frame, action.action, name))
    return _clip_to_run(steps, len(times_ns))


def _clip_to_run(steps: list[ProcessStep], frames: int) -> list[ProcessStep]:
    """The steps before the end of the run.

    A pause or cut that would outlast the run ends before the last frame.
    """
    inside = [step for step in steps if step.frame < frames]
    if not inside or inside[-1].action not in UNDONE_BY:
        return inside
    last = inside[-1]
    if last.frame >= frames - 1:
        return inside[:-1]
    return [*inside, ProcessStep(frames - 1, UNDONE_BY[last.action], last.node)]


def _band(fault: Fault, nodes: Sequence[str], backend: str, times_ns: Ints) -> dict[str, Any]:
    """The band of a fault on the timeline.

    A Join is shown from the start; a fault that outlasts the run has no end.
    """
    until_s = fault.over
    if until_s is not None and frame_at(times_ns, until_s) >= len(times_ns):
        until_s = None
    joins = [action for _, action in fault.events()] == ["start"]
    return band("fault", type(fault).__name__, 0.0 if joins else fault.at, until_s, nodes, backend)


def band(
    kind: str, of_type: str, at_s: float, until_s: float | None, nodes: Sequence[str], backend: str
) -> dict[str, Any]:
    """A band of the timeline, as in `FaultPlan.bands`. kind: fault, attack or link"""
    names = ", ".join(nodes) if len(nodes) <= _MAX_NAMES else f"{len(nodes)} nodes"
    return {
        "label": f"{of_type} {names}",
        "kind": kind,
        "type": of_type,
        "at_s": at_s,
        "until_s": until_s,
        "nodes": list(nodes),
        "backend": backend,
    }


#: Words for randomly drawn agents.
WORDS = ("one", "minority", "majority")

#: Roles that process faults must not target because the experiment depends on them, with the reason.
_PROTECTED = {
    "simulator": "it drives the scene",
    "evaluator": "it measures the run",
    "recorder": "it records the run",
    "visualizer": "it only displays the run",
    "link": "it is the network itself: use Partition, Loss or Delay",
}
#: Roles at the other end of every agent's link.
_SERVERS = ("broker", "command_center")


def draw_agents(word: str, agents: Sequence[str], rng: np.random.Generator) -> list[str]:
    """Randomly drawn agents, in the order of the scene.

    word: "one"; "minority": less than half, but at least one; "majority": more than half
    """
    n = len(agents)
    count = {"one": 1, "minority": max(1, (n - 1) // 2), "majority": n // 2 + 1}[word]
    return [agents[i] for i in sorted(rng.permutation(n)[:count])]


def resolve_names(
    selectors: Iterable[str], roles: Mapping[str, str], rng: np.random.Generator, place: str
) -> list[str]:
    """The target nodes of a fault, without duplicates.

    Names take precedence over roles, roles over words.

    roles: role of every node

    Raises ConfigurationError.
    """
    nodes: list[str] = []
    agents = [name for name, role in roles.items() if role == "agent"]
    for selector in selectors:
        if selector in roles:
            nodes.append(selector)
        elif selector in roles.values():
            nodes += [name for name, role in roles.items() if role == selector]
        elif selector in WORDS and agents:
            nodes += draw_agents(selector, agents, rng)
        else:
            hint = nearest(selector, {*roles, *roles.values(), *WORDS})
            raise ConfigurationError(f"{place}: no node, role or word {selector!r}{hint}")
    return list(dict.fromkeys(nodes))


def processes(selectors: Iterable[str], roles: Mapping[str, str], rng: np.random.Generator, place: str) -> list[str]:
    """Nodes with a process fault; raises ConfigurationError for protected roles."""
    nodes = resolve_names(selectors, roles, rng, place)
    for name in nodes:
        if reason := _PROTECTED.get(roles[name]):
            raise ConfigurationError(f"{place}: {name!r} cannot be the target of a process fault: {reason}")
    return nodes


def links_of(
    selectors: Iterable[str],
    roles: Mapping[str, str],
    ways: Mapping[str, Sequence[str]],
    rng: np.random.Generator,
    place: str,
    carriers: Callable[[], Carriers],
) -> dict[str, list[str]]:
    """The links that a fault acts on, as in `FaultPlan.rules`, each with its directions or sensors.

    Raises ConfigurationError for other targets.

    ways: the directions of the fault, by role of its target

    The broker and the command centre are at the other end of every agent's link. A key of a wire, or a glob, selects
    the one direction of the links that it passes through.
    """
    agents = [name for name, role in roles.items() if role == "agent"]
    names = {*roles, *roles.values(), *WORDS}
    chosen: dict[str, set[str]] = {}
    for selector in selectors:
        if "/" in selector or (selector not in names and selector in carriers()):
            for link, way in _on_wires(selector, carriers(), agents, tuple(ways.get("agent", ())) == (SENSOR,), place):
                chosen.setdefault(link, set()).add(way)
            continue
        for name in resolve_names([selector], roles, rng, place):
            role = roles[name]
            if role != "agent" and role not in _SERVERS:
                raise ConfigurationError(
                    f"{place}: {name!r} ({role}) has no link of its own; expected an agent, the broker or the "
                    "command centre"
                )
            if not ways[role]:
                raise ConfigurationError(f"{place}: {name!r} ({role}) has no sensor of its own; expected an agent")
            for agent in agents if role in _SERVERS else [name]:
                chosen.setdefault(agent, set()).update(ways[role])
    return {link: sorted(chosen[link]) for link in dict.fromkeys((*agents, *chosen)) if link in chosen}


def _on_wires(
    selector: str, carriers: Carriers, agents: Sequence[str], of_sensors: bool, place: str
) -> list[tuple[str, str]]:
    """Where a fault of the wires of a key or glob acts; a glob that matches wires of links means these alone.

    of_sensors: only wires of sensors are meant
    """
    known = {key: ends for key, ends in carriers.items() if not of_sensors or ends[0][1].startswith(SENSOR)}
    matching = [ends for key, ends in known.items() if fnmatchcase(key, selector)]
    if not matching:
        which = " goes through a link" if of_sensors else ""
        raise ConfigurationError(f"{place}: no wire {selector!r}{which}{nearest(selector, known)}")
    linked = [ends for ends in matching if ends[0][0] in agents and ends[0][1] in DIRECTIONS]
    return [end for ends in linked or matching for end in ends]


_STEP_S = 0.05  # times are multiples of it
_SHORTEST_S = 0.2


def random_schedule(
    seed: int,
    duration_s: float,
    agents: Sequence[str],
    *,
    servers: Sequence[str] = (),
    settle_s: float = 2.0,
    max_faults: int = 5,
    kinds: Sequence[str] | None = None,
) -> list[dict[str, Any]]:
    """A random list of faults, as for a scenario's `faults`.

    Equal arguments give equal lists.

    duration_s: of the run, s of scene time;  settle_s: fault-free time at the end, s
    agents:     possible targets
    servers:    other targets to kill, restart or cut off: "broker", "command_center"
    kinds:      types of faults to draw from; None: all

    The list is consistent: it never kills a stopped node. Raises ValueError if there is no time for a fault.
    """
    if kinds is None:
        kinds = tuple(_PARAMETERS)
    for kind in kinds:
        if kind not in _PARAMETERS:
            raise ValueError(f"kinds: no fault {kind!r}{nearest(str(kind), _PARAMETERS)}")
    if not agents or not kinds or max_faults < 1:
        raise ValueError("expected at least one agent, one kind and one fault")
    ticks = int((duration_s - settle_s) / _STEP_S + 1e-9)
    shortest = round(_SHORTEST_S / _STEP_S)
    if ticks < shortest + 1:
        raise ValueError(f"duration_s: found {duration_s}, expected {settle_s + _SHORTEST_S + _STEP_S:g} or more")
    rng = stream(seed, "faults", "schedule")
    busy: dict[str, list[tuple[int, int]]] = {}
    faults: list[dict[str, Any]] = []
    for _ in range(int(rng.integers(1, max_faults + 1))):
        kind = str(rng.choice(list(kinds)))
        start = int(rng.integers(1, ticks - shortest + 1))
        end = int(rng.integers(start + shortest, ticks + 1))
        fault: dict[str, Any] = {"type": kind, "at": _seconds(start)}
        if kind in _PROCESS:
            node = str(rng.choice([*agents, *(servers if kind != "Join" else ())]))
            taken = busy.setdefault(node, [])
            # A joining node is absent from the start; a frame may be longer than a tick, so leave a margin around each.
            span = (0 if kind == "Join" else start - _MARGIN, end + _MARGIN)
            if any(span[0] < last and first < span[1] for first, last in taken):
                continue
            taken.append(span)
            fault["node"] = node
            fault |= {"Join": {"at": _seconds(end)}, "Pause": {"until": _seconds(end)}}.get(kind, {})
            if kind in _WAIT:
                fault[_WAIT[kind]] = _seconds(end - start)
        else:
            fault |= {"until": _seconds(end), **_targets(rng, agents, servers), **_PARAMETERS[kind](rng)}
        faults.append(fault)
    return sorted(faults, key=lambda fault: fault["at"])


_MARGIN = 5  # ticks between two faults of one process
_WAIT = {"Kill": "restart_after", "Leave": "return_after", "Restart": "down_s"}
_PROCESS = (*_WAIT, "Join", "Pause")

_Sampler = Callable[[np.random.Generator], dict[str, Any]]


def _uniform(low: float, high: float, name: str) -> _Sampler:
    return lambda rng: {name: round(float(rng.uniform(low, high)), 3)}


#: Random parameters by type of fault.
_PARAMETERS: dict[str, _Sampler] = {
    **dict.fromkeys((*_PROCESS, "Partition"), lambda rng: {}),
    "Loss": _uniform(0.05, 0.9, "probability"),
    "BurstLoss": lambda rng: {**_uniform(0.05, 0.5, "good_to_bad")(rng), **_uniform(0.1, 0.8, "bad_to_good")(rng)},
    "Delay": lambda rng: {**_uniform(0.0, 0.4, "mean_s")(rng), **_uniform(0.0, 0.1, "jitter_s")(rng)},
    "SlowNode": _uniform(0.05, 0.5, "delay_s"),
    "BandwidthLimit": lambda rng: {"bits_per_s": round(10.0 ** float(rng.uniform(5.3, 6.5)))},
    "Corrupt": lambda rng: {**_uniform(0.05, 0.9, "probability")(rng), "flips": int(rng.integers(1, 20))},
    "Duplicate": lambda rng: {**_uniform(0.1, 1.0, "probability")(rng), "copies": int(rng.integers(1, 4))},
    "Flood": lambda rng: {"copies": int(rng.integers(1, 9))},
    "Reorder": lambda rng: {**_uniform(0.1, 0.9, "probability")(rng), **_uniform(0.05, 0.3, "by_s")(rng)},
}


def _seconds(ticks: int) -> float:
    return round(ticks * _STEP_S, 3)


def _targets(rng: np.random.Generator, agents: Sequence[str], servers: Sequence[str]) -> dict[str, Any]:
    """Draw targets: agents by name or by a word, or a server."""
    way = int(rng.integers(4))
    if way == 0 and servers:
        return {"node": str(rng.choice(list(servers)))}
    if way == 1:
        return {"nodes": str(rng.choice(["one", "minority", "majority", "agent"]))}
    count = int(rng.integers(1, len(agents) + 1))
    return {"nodes": [agents[i] for i in sorted(rng.permutation(len(agents))[:count])]}
