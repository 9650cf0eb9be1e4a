"""Latency of messages on the wall clock, from sending a frame to their arrival."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.wiring.model import Wire, Wiring

#: Arrival of the first message of each frame, by key and frame, ns; and time at which each frame was sent, ns.
Arrivals = Mapping[str, Mapping[int, int]]
Sent = Mapping[int, int]

PERCENTILES = (50, 95, 99)


def latency_ms(wiring: Wiring, outcomes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The `latency_ms` of metrics.json: from simulator to picture, and of every wire.

    outcomes: what each node has handed in
    """
    sent, arrived = on_launcher_clock(outcomes)
    picture = percentiles(sent, arrived.get("evaluator", {}).get("cc/picture", {}))
    to_picture = picture or dict.fromkeys(f"p{p}" for p in PERCENTILES)
    return {"sim_to_picture": to_picture, "by_wire": by_wire(wiring, sent, arrived)}


def by_wire(wiring: Wiring, sent_ns: Sent, arrived_ns: Mapping[str, Arrivals]) -> dict[str, dict[str, float | int]]:
    """Percentiles in ms and number of frames of every wire that carried messages.

    sent_ns: when the simulator sent each frame; arrived_ns: arrivals at each node

    Of a wire's subscribers, the first that publishes something itself counts, because others wait for it; if none of
    those received anything, the first of the others. Interposers and nodes that overhear every key do not count.
    """
    publishers = {leg.publisher.node for _, leg in wiring.legs()}
    latencies: dict[str, dict[str, float | int]] = {}
    for wire in wiring.wires:
        for key, node in sorted(_subscriptions(wire), key=lambda end: end[1] not in publishers):
            if wire_latency := percentiles(sent_ns, arrived_ns.get(node, {}).get(key, {})):
                latencies[wire.key] = wire_latency
                break
    return latencies


def percentiles(sent_ns: Sent, arrival_ns: Mapping[int, int]) -> dict[str, float | int]:
    """Percentiles in ms from sending to arrival, and number of frames that arrived."""
    latency = [(arrival_ns[frame] - sent_ns[frame]) * 1e-6 for frame in arrival_ns if frame in sent_ns]
    if not latency:
        return {}
    return {f"p{p}": round(float(np.percentile(latency, p)), 3) for p in PERCENTILES} | {"n": len(latency)}


def on_launcher_clock(outcomes: Mapping[str, Mapping[str, Any]]) -> tuple[Sent, dict[str, Arrivals]]:
    """Times at which frames were sent and arrived, on the launcher's clock, ns.

    outcomes: what each node has handed in; a node on another host has `clock`, how far its clock is ahead
    """
    sent: Sent = {}
    arrived: dict[str, Arrivals] = {}
    for name, outcome in outcomes.items():
        ahead_ns = round(outcome.get("clock", {}).get("offset_ms", 0.0) * 1e6)
        arrivals = outcome.get("arrived_ns", {})
        arrived[name] = {key: {frame: at - ahead_ns for frame, at in times.items()} for key, times in arrivals.items()}
        if "sent_ns" in outcome:
            sent = {frame: at - ahead_ns for frame, at in outcome["sent_ns"].items()}
    return sent, arrived


def _subscriptions(wire: Wire) -> list[tuple[str, str]]:
    """(key, node) of each subscriber of the wire, with the key that it subscribes to."""
    key_of = {end: leg.key for leg in wire.every_leg for end in leg.subscribers}
    return [(key_of[end], end.node) for end in wire.subscribers]
