"""The estimate that is on each key of a wiring."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from mast_zenoh.evaluation.estimate_wires import estimates_on
from mast_zenoh.metrics.estimates import LOCAL, MISSION, PICTURE, PICTURE_RECEIVED, RECEIVED
from mast_zenoh.metrics.record import Series
from mast_zenoh.wiring.model import Wire, Wiring

#: The objects of the scene, as a series like the estimates; and what else frames are made of.
TRUTH, CLOCK = Series("", "truth"), Series("", "clock")
#: Names of the series of an agent's poses, and of the trust that a centre or a peer has.
POSE, TRUST = "pose", "trust"
#: Name of the series of the scans of an agent's lidar, if they were recorded.
POINTS = "points"


def routes(wiring: Wiring, agents: Sequence[str]) -> dict[str, list[Series]]:
    """The series of each key; keys without one are left out.

    Estimates as received (`received`, `picture_received`) are series of their own only where a node sits on the wire.
    """
    result: dict[str, list[Series]] = {}
    for _, key, series in _keys(wiring, agents):
        result.setdefault(key, []).append(series)
    return result


def topics(wiring: Wiring, agents: Sequence[str]) -> dict[Series, str]:
    """A key expression for each series of objects: that of its wire, with `/received` for those as received."""
    names: dict[Series, str] = {}
    for wire, _, series in _keys(wiring, agents):
        if series.estimator not in (CLOCK.estimator, POSE, TRUST):
            ending = {RECEIVED: "/received", PICTURE_RECEIVED: f"/received/{series.agent}"}.get(series.estimator, "")
            names[series] = wire.key + ending
    return names


def scan_keys(wiring: Wiring, agents: Sequence[str]) -> dict[str, list[Series]]:
    """The series of each key on which the scans of an agent's lidar arrive, after all interposers."""
    wires = (wire for wire in wiring.wires if wire.message == POINTS and wire.subject in agents)
    return {wire.last_legs[0].key: [Series(wire.subject, POINTS)] for wire in wires if wire.last_legs}


def in_order(series: Mapping[Series, str], agents: Sequence[str]) -> dict[Series, str]:
    """Series with the truth first, then the pictures, then the estimates of each agent."""
    rank = [TRUTH.estimator, PICTURE, PICTURE_RECEIVED, LOCAL, RECEIVED, MISSION].index
    place = ["", *agents].index

    def key(each: Series) -> tuple[bool, int, int]:
        pictures = each.estimator in (TRUTH.estimator, PICTURE, PICTURE_RECEIVED)
        return not pictures, rank(each.estimator) if pictures else place(each.agent), rank(each.estimator)

    return {each: series[each] for each in sorted(series, key=key)}


def _keys(wiring: Wiring, agents: Sequence[str]) -> Iterator[tuple[Wire, str, Series]]:
    """Every wire with a key of it and the series on that key."""
    for wire in wiring.wires:
        source = wire.legs[0]
        if series := _besides_estimates(wire, agents):
            yield wire, source.key, series
    for wire, key, series, receiver in estimates_on(wiring, agents):
        if not receiver or key != wire.legs[0].key:
            yield wire, key, series


def _besides_estimates(wire: Wire, agents: Sequence[str]) -> Series | None:
    """The series on a wire without an estimate that frames are made of."""
    if wire.message == "clock":
        return CLOCK
    if wire.message == "truth":
        return TRUTH
    if wire.message == TRUST:
        return Series(wire.legs[0].publisher.node, TRUST)
    return Series(wire.subject, POSE) if wire.message == "pose" and wire.subject in agents else None
