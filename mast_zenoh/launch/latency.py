"""How long messages were under way, on the wall clock: from the moment a frame was sent to that at which they came."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.wiring.model import Wire, Wiring

#: When the first message of each frame came, by key and frame, ns; and when each frame was sent, ns.
Arrivals = Mapping[str, Mapping[int, int]]
Sent = Mapping[int, int]

PERCENTILES = (50, 95, 99)


def measured(wiring: Wiring, outcomes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The `latency_ms` of metrics.json, by what nodes have handed in: from simulator to picture, and of every wire."""
    sent, arrived = by_one_clock(outcomes)
    picture = between(sent, arrived.get("evaluator", {}).get("cc/picture", {}))
    to_picture = picture or dict.fromkeys(f"p{p}" for p in PERCENTILES)
    return {"sim_to_picture": to_picture, "by_wire": by_wire(wiring, sent, arrived)}


def by_wire(wiring: Wiring, sent_ns: Sent, arrived_ns: Mapping[str, Arrivals]) -> dict[str, dict[str, float | int]]:
    """Percentiles in ms of every wire on which something was heard, and of how many frames.

    sent_ns: when the simulator sent each frame; arrived_ns: what each node has noted

    Of a wire's subscribers the first counts that says something itself, since that is who is waited for; if none of
    those has heard anything, the first of the others. What an interposer hears, or somebody who overhears every key,
    does not count.
    """
    speakers = {leg.publisher.node for _, leg in wiring.legs()}
    found: dict[str, dict[str, float | int]] = {}
    for wire in wiring.wires:
        for key, node in sorted(_heard(wire), key=lambda end: end[1] not in speakers):
            if measured := between(sent_ns, arrived_ns.get(node, {}).get(key, {})):
                found[wire.key] = measured
                break
    return found


def between(sent_ns: Sent, came_ns: Mapping[int, int]) -> dict[str, float | int]:
    """Percentiles in ms from the one to the other, over the frames that are in both, and how many those are."""
    latency = [(came_ns[frame] - sent_ns[frame]) * 1e-6 for frame in came_ns if frame in sent_ns]
    if not latency:
        return {}
    return {f"p{p}": round(float(np.percentile(latency, p)), 3) for p in PERCENTILES} | {"n": len(latency)}


def by_one_clock(outcomes: Mapping[str, Mapping[str, Any]]) -> tuple[Sent, dict[str, Arrivals]]:
    """When frames were sent and came, by what nodes have handed in, all on the launcher's clock.

    A node on another host has handed in how far its clock was ahead (`clock`); none has, whose clock is the launcher's.
    """
    sent: Sent = {}
    arrived: dict[str, Arrivals] = {}
    for name, outcome in outcomes.items():
        ahead = round(outcome.get("clock", {}).get("offset_ms", 0.0) * 1e6)
        came = outcome.get("arrived_ns", {})
        arrived[name] = {key: {frame: at - ahead for frame, at in noted.items()} for key, noted in came.items()}
        if "sent_ns" in outcome:
            sent = {frame: at - ahead for frame, at in outcome["sent_ns"].items()}
    return sent, arrived


def _heard(wire: Wire) -> list[tuple[str, str]]:
    """(key, node) of those for whom the wire is, in their order, by the key on which they hear it."""
    key_of = {end: leg.key for leg in wire.every_leg for end in leg.subscribers}
    return [(key_of[end], end.node) for end in wire.subscribers]
