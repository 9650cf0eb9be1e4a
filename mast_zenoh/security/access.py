"""Who may do what on the router, from the wiring alone. Pure: a wiring in, Zenoh's `access_control` out.

Everything is denied but this, to each certificate by its common name:

    a node       say     its own keys, counts/{self}, failed/{self}
                 hear    its own keys, epoch, stop, leave/{self}
                 ask     result/{self}, fetch/{self}, file/{self}
                 appear  alive/{self};  watch launcher
    the driver   say     epoch, act, stop;  hear counts/*;  watch alive/*
    the launcher say     stop, leave/*;  hear clock, act, failed/*;  answer result/*, fetch/*, file/*
                 appear  launcher;  watch alive/*

What changes the wiring of a run (intercept, rewire, drain) is nobody's: these rules are fixed when the router opens.

A key that was rewritten lies under @tap and belongs to the two ends of its leg like any other. Who overhears every key
(a recorder) may hear every key, because the wiring says so.

Flows are seen from the router: *ingress* is what a client sends to it. A publisher sends nothing unless it knows of a
subscriber, and that knowledge is a declaration on *egress*: without that right it is silent, and nobody says so. A
right covers the whole expression of a message: who may put `a/b` may not put `a/*`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from mast_zenoh.security.credentials import LAUNCHER
from mast_zenoh.wiring.model import Wiring

CONTROL = "@control"

#: What nodes ask the launcher: below each of these lies one key for every node.
ASKED = ("result", "fetch", "file")


#: What nodes report: the first to the driver, the second to the launcher.
REPORTS = ("counts", "failed")


class Right(NamedTuple):
    """A message that may pass. flow: ingress (to the router) or egress; message: Zenoh's word; key: an expression."""

    flow: str
    message: str
    key: str


def say(key: str, heard_as: str = "") -> Iterator[Right]:
    """Publish on a key. heard_as: the expression that its subscriber declares, where that is wider."""
    yield Right("ingress", "put", key)
    yield Right("egress", "declare_subscriber", heard_as or key)


def hear(key: str) -> Iterator[Right]:
    """Subscribe to a key expression."""
    yield Right("ingress", "declare_subscriber", key)
    yield Right("egress", "put", key)


def ask(key: str, answered_as: str = "") -> Iterator[Right]:
    """Query a key. answered_as: the expression that whoever answers declares, where that is wider."""
    yield Right("ingress", "query", key)
    yield Right("egress", "declare_queryable", answered_as or key)
    yield Right("egress", "reply", key)


def answer(key: str) -> Iterator[Right]:
    """Answer queries on a key expression."""
    yield Right("ingress", "declare_queryable", key)
    yield Right("egress", "query", key)
    yield Right("ingress", "reply", key)


def appear(key: str) -> Iterator[Right]:
    """Show that one is there, by a liveliness token."""
    yield Right("ingress", "liveliness_token", key)


def watch(key: str) -> Iterator[Right]:
    """See who is there."""
    yield Right("ingress", "declare_liveliness_subscriber", key)
    yield Right("egress", "liveliness_token", key)


def rights(wiring: Wiring, node: str, *, driver: str) -> list[Right]:
    """What a node may do, or LAUNCHER; keys without the run's prefix, in a fixed order, each once."""
    found = _launcher() if node == LAUNCHER else _node(wiring, node, drives=node == driver)
    return list(dict.fromkeys(found))


def access_control(wiring: Wiring, names: Mapping[str, str], *, prefix: str, driver: str) -> dict[str, Any]:
    """Zenoh's `access_control` for the router of a run.

    names:  node (or LAUNCHER) to the common name in its certificate; whoever is not in it may do nothing
    prefix: of all keys of the run, "mast/RUN"
    driver: the node that drives the scene
    """
    rules, subjects, policies = [], [], []
    for node, common in names.items():
        grouped: dict[tuple[str, str], list[str]] = defaultdict(list)
        for right in rights(wiring, node, driver=driver):
            grouped[right.flow, right.message].append(f"{prefix}/{right.key}")
        ids = []
        for (flow, message), keys in grouped.items():
            ids.append(f"{node}: {message} {flow}")
            rules.append(
                {"id": ids[-1], "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": keys}
            )
        subjects.append({"id": node, "cert_common_names": [common]})
        policies.append({"rules": ids, "subjects": [node]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _node(wiring: Wiring, node: str, *, drives: bool) -> Iterator[Right]:
    for _, leg in wiring.legs():
        if leg.publisher.node == node:
            yield from say(leg.key)
    for key, _, subscriber in wiring.flows():
        if subscriber == node:
            yield from hear(key)
    for report in REPORTS:
        yield from say(f"{CONTROL}/{report}/{node}", f"{CONTROL}/{report}/*")
    yield from _each(hear, "epoch", "stop", f"leave/{node}")
    for asked in ASKED:
        yield from ask(f"{CONTROL}/{asked}/{node}", f"{CONTROL}/{asked}/*")
    yield from appear(f"alive/{node}")
    yield from watch(f"{CONTROL}/launcher")
    if drives:
        yield from _each(say, "epoch", "act", "stop")
        yield from _each(hear, "counts/*")
        yield from watch("alive/*")


def _launcher() -> Iterator[Right]:
    yield from hear("clock")
    yield from _each(say, "stop", "leave/*")
    yield from _each(hear, "act", "failed/*")
    yield from _each(answer, *(f"{asked}/*" for asked in ASKED))
    yield from appear(f"{CONTROL}/launcher")
    yield from watch("alive/*")


def _each(verb: Callable[[str], Iterable[Right]], *controls: str) -> Iterator[Right]:
    for control in controls:
        yield from verb(f"{CONTROL}/{control}")
