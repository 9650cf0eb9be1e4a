"""Whom a fault hits: names, roles, words that draw lots, keys of wires; and who cannot be hit, and why."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase

import numpy as np

from mast_zenoh.errors import ConfigurationError, nearest
from mast_zenoh.faults.base import DIRECTIONS

#: Words for agents drawn by lot.
WORDS = ("one", "minority", "majority")

#: Nodes of these roles carry the experiment; without them there is nothing to see.
_NO_PROCESS = {
    "simulator": "it drives the scene",
    "evaluator": "it is the measurement",
    "recorder": "it keeps the record",
    "visualizer": "it only looks on",
    "link": "it is the network itself: use Partition, Loss or Delay",
}
#: Roles that stand at the other end of every agent's link.
_CENTRE = ("broker", "command_center")


def drawn(word: str, agents: Sequence[str], rng: np.random.Generator) -> list[str]:
    """Agents drawn by lot, in the order of the scene: one; less than half of n, at least one; more than half."""
    n = len(agents)
    count = {"one": 1, "minority": max(1, (n - 1) // 2), "majority": n // 2 + 1}[word]
    return [agents[i] for i in sorted(rng.permutation(n)[:count])]


def named(
    aims: Iterable[str], roles: Mapping[str, str], rng: np.random.Generator, place: str, more: Iterable[str] = ()
) -> list[str]:
    """The nodes that the targets of a fault mean, each once. A name wins over a role, a role over a word.

    roles: role of every node;  more: what else may be said here, for the error

    Raises ConfigurationError.
    """
    found: list[str] = []
    agents = [name for name, role in roles.items() if role == "agent"]
    for aim in aims:
        if aim in roles:
            found.append(aim)
        elif aim in roles.values():
            found += [name for name, role in roles.items() if role == aim]
        elif aim in WORDS and agents:
            found += drawn(aim, agents, rng)
        else:
            hint = nearest(aim, {*roles, *roles.values(), *WORDS, *more})
            raise ConfigurationError(f"{place}: no node, role or word {aim!r}{hint}")
    return list(dict.fromkeys(found))


def processes(aims: Iterable[str], roles: Mapping[str, str], rng: np.random.Generator, place: str) -> list[str]:
    """The nodes whose processes a fault acts on; raises ConfigurationError for those that must not be touched."""
    found = named(aims, roles, rng, place)
    for name in found:
        if reason := _NO_PROCESS.get(roles[name]):
            raise ConfigurationError(f"{place}: {name!r} cannot be the target of a process fault: {reason}")
    return found


def links(
    aims: Iterable[str],
    roles: Mapping[str, str],
    ways: Mapping[str, Sequence[str]],
    rng: np.random.Generator,
    place: str,
) -> dict[str, list[str]]:
    """The agents whose links a fault acts on, and in which of DIRECTIONS. Raises ConfigurationError for others.

    ways: the directions that the fault means, by role of its target

    The broker and the command centre are at the other end of every agent's link. A key of a wire, or a glob of such,
    means the one direction of those agents' links that it goes through.
    """
    agents = [name for name, role in roles.items() if role == "agent"]
    keys = [f"agent/{name}/{port}" for name in agents for port in ("tracks", "status")] + ["cc/picture"]
    found: dict[str, set[str]] = {}
    for aim in aims:
        if "/" in aim:
            matching = [key for key in keys if fnmatchcase(key, aim)]
            if not matching:
                raise ConfigurationError(f"{place}: no wire {aim!r} goes through a link{nearest(aim, keys)}")
            for key in matching:
                for name in agents if key == "cc/picture" else [key.split("/")[1]]:
                    found.setdefault(name, set()).add("down" if key == "cc/picture" else "up")
            continue
        for name in named([aim], roles, rng, place, more=keys):
            role = roles[name]
            if role != "agent" and role not in _CENTRE:
                raise ConfigurationError(
                    f"{place}: {name!r} ({role}) has no link of its own; expected an agent, the broker or the "
                    "command centre"
                )
            for agent in agents if role in _CENTRE else [name]:
                found.setdefault(agent, set()).update(ways[role])
    return {name: [way for way in DIRECTIONS if way in found[name]] for name in agents if name in found}
