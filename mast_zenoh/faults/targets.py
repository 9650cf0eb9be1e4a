"""Resolves targets of faults: names, roles, words for random agents, wire keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from types import MappingProxyType

import numpy as np

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.faults.base import DIRECTIONS, SENSOR

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
    selectors: Iterable[str],
    roles: Mapping[str, str],
    rng: np.random.Generator,
    place: str,
    more: Iterable[str] = (),
) -> list[str]:
    """The target nodes of a fault, without duplicates.

    Names take precedence over roles, roles over words.

    roles: role of every node;  more: other valid targets, for the error message

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
            hint = nearest(selector, {*roles, *roles.values(), *WORDS, *more})
            raise ConfigurationError(f"{place}: no node, role or word {selector!r}{hint}")
    return list(dict.fromkeys(nodes))


def processes(selectors: Iterable[str], roles: Mapping[str, str], rng: np.random.Generator, place: str) -> list[str]:
    """Nodes with a process fault; raises ConfigurationError for protected roles."""
    nodes = resolve_names(selectors, roles, rng, place)
    for name in nodes:
        if reason := _PROTECTED.get(roles[name]):
            raise ConfigurationError(f"{place}: {name!r} cannot be the target of a process fault: {reason}")
    return nodes


def links(
    selectors: Iterable[str],
    roles: Mapping[str, str],
    ways: Mapping[str, Sequence[str]],
    rng: np.random.Generator,
    place: str,
    sensors: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> dict[str, list[str]]:
    """The agents whose links a fault acts on, with DIRECTIONS, or with the sensors: SENSOR, or SENSOR/name.

    Raises ConfigurationError for other targets.

    ways: the directions of the fault, by role of its target; sensors: names of agents' sensors besides the first

    The broker and the command centre are at the other end of every agent's link. A key of a wire, or a glob, selects
    the one direction of the links that it passes through.
    """
    agents = [name for name, role in roles.items() if role == "agent"]
    if tuple(ways.get("agent", ())) == (SENSOR,):
        parts = {name: ("", *sensors.get(name, ())) for name in agents}
        keys = [f"agent/{name}/detections{part and f'/{part}'}" for name in agents for part in parts[name]]
    else:
        keys = [f"agent/{name}/{port}" for name in agents for port in ("tracks", "status")] + ["cc/picture"]
    directions: dict[str, set[str]] = {}
    for selector in selectors:
        if "/" in selector:
            matching = [key for key in keys if fnmatchcase(key, selector)]
            if not matching:
                raise ConfigurationError(f"{place}: no wire {selector!r} goes through a link{nearest(selector, keys)}")
            for key in matching:
                for name in agents if key == "cc/picture" else [key.split("/")[1]]:
                    directions.setdefault(name, set()).add(_way(key))
            continue
        for name in resolve_names([selector], roles, rng, place, more=keys):
            role = roles[name]
            if role != "agent" and role not in _SERVERS:
                raise ConfigurationError(
                    f"{place}: {name!r} ({role}) has no link of its own; expected an agent, the broker or the "
                    "command centre"
                )
            if not ways[role]:
                raise ConfigurationError(f"{place}: {name!r} ({role}) has no sensor of its own; expected an agent")
            for agent in agents if role in _SERVERS else [name]:
                directions.setdefault(agent, set()).update(ways[role])
    order = [*DIRECTIONS, SENSOR]
    return {
        name: [way for way in order if way in directions[name]] + sorted(directions[name].difference(order))
        for name in agents
        if name in directions
    }


def _way(key: str) -> str:
    """The direction of a link, or the sensor, that messages of a key belong to."""
    if key == "cc/picture":
        return "down"
    _, _, port, *part = key.split("/")
    return "/".join([SENSOR, *part]) if port == "detections" else "up"
