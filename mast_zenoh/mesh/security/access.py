"""Access rights on the router: a pure function from a wiring to `access_control`.

Everything is denied except these rights, given to each certificate by its common name:

    node      publish    its own keys, counts/{self}, failed/{self}
              subscribe  its own keys, epoch, stop, leave/{self}
              query      result/{self}, fetch/{self}, file/{self}
              announce   alive/{self};  watch launcher
    driver    publish    epoch, act, stop;  subscribe counts/*;  watch alive/*
    launcher  publish    stop, leave/*;  subscribe clock, act, failed/*;  answer result/*, fetch/*, file/*
              announce   launcher;  watch alive/*
    viewer    subscribe  every key of the wiring;  watch alive/*      (only if the run was started with one)

No process may change the wiring of a run (intercept, rewire, drain): these rules are fixed when the router opens.

A rewritten key is below @tap and belongs to the two ends of its leg like any other. A node that receives every key (a
recorder) may subscribe to every key, because the wiring says so.

Flows are seen from the router: *ingress* is what a client sends to it. A publisher sends nothing unless it knows of a
subscriber, from a declaration on *egress*: without that right it is silent, without any error. A right must cover the
whole key expression of a message: a right to put `a/b` does not allow `a/*`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from mast_zenoh.mesh.security.credentials import LAUNCHER, VIEWER
from mast_zenoh.wiring.model import Wiring

CONTROL = "@control"

#: Queries of nodes to the launcher: below each of these is one key for every node.
QUERIES = ("result", "fetch", "file")


#: Reports of nodes: the first to the driver, the second to the launcher.
REPORTS = ("counts", "failed")


class Right(NamedTuple):
    """A permitted message.

    flow: ingress (to the router) or egress; message: Zenoh's name; key: an expression
    """

    flow: str
    message: str
    key: str


def publish(key: str, subscribed_as: str = "") -> Iterator[Right]:
    """Publish on a key; subscribed_as: the subscriber's expression, if it is wider."""
    yield Right("ingress", "put", key)
    yield Right("egress", "declare_subscriber", subscribed_as or key)


def subscribe(key: str) -> Iterator[Right]:
    """Subscribe to a key expression."""
    yield Right("ingress", "declare_subscriber", key)
    yield Right("egress", "put", key)


def query(key: str, answered_as: str = "") -> Iterator[Right]:
    """Query a key; answered_as: the queryable's expression, if it is wider."""
    yield Right("ingress", "query", key)
    yield Right("egress", "declare_queryable", answered_as or key)
    yield Right("egress", "reply", key)


def answer(key: str) -> Iterator[Right]:
    """Answer queries on a key expression."""
    yield Right("ingress", "declare_queryable", key)
    yield Right("egress", "query", key)
    yield Right("ingress", "reply", key)


def announce(key: str) -> Iterator[Right]:
    """Announce oneself by a liveliness token."""
    yield Right("ingress", "liveliness_token", key)


def watch(key: str) -> Iterator[Right]:
    """Watch liveliness tokens."""
    yield Right("ingress", "declare_liveliness_subscriber", key)
    yield Right("egress", "liveliness_token", key)


def count_present(key: str) -> Iterator[Right]:
    """Ask which liveliness tokens there are."""
    yield Right("ingress", "liveliness_query", key)


def rights(wiring: Wiring, node: str, *, driver: str) -> list[Right]:
    """The rights of a node, of LAUNCHER or of VIEWER, each once, in a fixed order.

    Keys are without the run's prefix.
    """
    if node == LAUNCHER:
        granted = _launcher()
    elif node == VIEWER:
        granted = _viewer(wiring)
    else:
        granted = _node(wiring, node, drives=node == driver)
    return list(dict.fromkeys(granted))


def access_control(wiring: Wiring, names: Mapping[str, str], *, prefix: str, driver: str) -> dict[str, Any]:
    """Zenoh's `access_control` for the router of a run.

    names:  node (or LAUNCHER, VIEWER) to the common name in its certificate; other processes have no rights
    prefix: of all keys of the run, "mast/RUN"
    driver: the node that drives the scene
    """
    rules, subjects, policies = [], [], []
    for node, common_name in names.items():
        grouped: dict[tuple[str, str], list[str]] = defaultdict(list)
        for right in rights(wiring, node, driver=driver):
            grouped[right.flow, right.message].append(f"{prefix}/{right.key}")
        ids = []
        for (flow, message), keys in grouped.items():
            ids.append(f"{node}: {message} {flow}")
            rules.append(
                {"id": ids[-1], "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": keys}
            )
        subjects.append({"id": node, "cert_common_names": [common_name]})
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
            yield from publish(leg.key)
    for key, _, subscriber in wiring.flows():
        if subscriber == node:
            yield from subscribe(key)
    for report in REPORTS:
        yield from publish(f"{CONTROL}/{report}/{node}", f"{CONTROL}/{report}/*")
    yield from _each(subscribe, "epoch", "stop", f"leave/{node}")
    for query_name in QUERIES:
        yield from query(f"{CONTROL}/{query_name}/{node}", f"{CONTROL}/{query_name}/*")
    yield from announce(f"alive/{node}")
    yield from watch(f"{CONTROL}/launcher")
    if drives:
        yield from _each(publish, "epoch", "act", "stop")
        yield from _each(subscribe, "counts/*")
        yield from watch("alive/*")


def _launcher() -> Iterator[Right]:
    yield from subscribe("clock")
    yield from _each(publish, "stop", "leave/*")
    yield from _each(subscribe, "act", "failed/*")
    yield from _each(answer, *(f"{query_name}/*" for query_name in QUERIES))
    yield from announce(f"{CONTROL}/launcher")
    yield from watch("alive/*")


def _viewer(wiring: Wiring) -> Iterator[Right]:
    """It publishes nothing, so it cannot influence the run."""
    for _, leg in wiring.legs():
        yield from subscribe(leg.key)
    yield from watch("alive/*")
    yield from count_present("alive/*")


def _each(right: Callable[[str], Iterable[Right]], *controls: str) -> Iterator[Right]:
    for control in controls:
        yield from right(f"{CONTROL}/{control}")
