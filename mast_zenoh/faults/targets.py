"""Resolves the targets of faults: names, roles, words for random agents, keys of wires."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase

import numpy as np

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.faults.base import DIRECTIONS

#: Words for randomly drawn agents.
WORDS = ("one", "minority", "majority")

#: Roles that process faults must not target because the experiment depends on them, with the reason.
_PROTECTED = {
    "simulator": "it drives the scene",
    "evaluator": "it is the measurement",
    "recorder": "it keeps the record",
    "visualizer": "it only looks on",
    "link": "it is the network itself: use Partition, Loss or Delay",
}
#: Roles at the other end of every agent's link.
_SERVERS = ("broker", "command_center")


def draw_agents(word: str, agents: Sequence[str], rng: np.random.Generator) -> list[str]:
    """Randomly drawn agents, in the order of the scene: one; less than half of n, at least one; more than half."""
    n = len(agents)
    count = {"one": 1, "minority": max(1, (n - 1) // 2), "majority": n // 2 + 1}[word]
    return [agents[i] for i in sorted(rng.permutation(n)[:count])]


def resolve_names(
    aims: Iterable[str], roles: Mapping[str, str], rng: np.random.Generator, place: str, more: Iterable[str] = ()
) -> list[str]:
    """The target nodes of a fault, each once. Names take precedence over roles, roles over words.

    roles: role of every node;  more: further valid targets, for the error message

    Raises ConfigurationError.
    """
    nodes: list[str] = []
    agents = [name for name, role in roles.items() if role == "agent"]
    for aim in aims:
        if aim in roles:
            nodes.append(aim)
        elif aim in roles.values():
            nodes += [name for name, role in roles.items() if role == aim]
        elif aim in WORDS and agents:
            nodes += draw_agents(aim, agents, rng)
        else:
            hint = nearest(aim, {*roles, *roles.values(), *WORDS, *more})
            raise ConfigurationError(f"{place}: no node, role or word {aim!r}{hint}")
    return list(dict.fromkeys(nodes))


def processes(aims: Iterable[str], roles: Mapping[str, str], rng: np.random.Generator, place: str) -> list[str]:
    """The nodes whose processes a fault acts on; raises ConfigurationError for protected roles."""
    nodes = resolve_names(aims, roles, rng, place)
    for name in nodes:
        if reason := _PROTECTED.get(roles[name]):
            raise ConfigurationError(f"{place}: {name!r} cannot be the target of a process fault: {reason}")
    return nodes


def links(
    aims: Iterable[str],
    roles: Mapping[str, str],
    ways: Mapping[str, Sequence[str]],
    rng: np.random.Generator,
    place: str,
) -> dict[str, list[str]]:
    """The agents whose links a fault acts on, with DIRECTIONS. Raises ConfigurationError for other targets.

    ways: the directions of the fault, by role of its target

    The broker and the command centre are at the other end of every agent's link. A key of a wire, or a glob, selects
    the one direction of the links that it passes through.
    """
    agents = [name for name, role in roles.items() if role == "agent"]
    keys = [f"agent/{name}/{port}" for name in agents for port in ("tracks", "status")] + ["cc/picture"]
    directions: dict[str, set[str]] = {}
    for aim in aims:
        if "/" in aim:
            matching = [key for key in keys if fnmatchcase(key, aim)]
            if not matching:
                raise ConfigurationError(f"{place}: no wire {aim!r} goes through a link{nearest(aim, keys)}")
            for key in matching:
                for name in agents if key == "cc/picture" else [key.split("/")[1]]:
                    directions.setdefault(name, set()).add("down" if key == "cc/picture" else "up")
            continue
        for name in resolve_names([aim], roles, rng, place, more=keys):
            role = roles[name]
            if role != "agent" and role not in _SERVERS:
                raise ConfigurationError(
                    f"{place}: {name!r} ({role}) has no link of its own; expected an agent, the broker or the "
                    "command centre"
                )
            for agent in agents if role in _SERVERS else [name]:
                directions.setdefault(agent, set()).update(ways[role])
    return {name: [way for way in DIRECTIONS if way in directions[name]] for name in agents if name in directions}
