"""On which keys the messages of drivers are: what they drive by, and their commands to their cars."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from mast_zenoh.wiring.model import Wiring

#: By car, (port, key) of each of its driver's messages; key "": they are left out.
PlayedDrivers = Mapping[str, Sequence[Sequence[str]]]


def check_played(played: PlayedDrivers) -> None:
    """Raise ValueError unless these are the messages of played drivers."""
    for car, inputs in played.items():
        pairs = inputs if isinstance(inputs, (list, tuple)) else [None]
        if not all(isinstance(pair, (list, tuple)) and [*map(type, pair)] == [str, str] for pair in pairs):
            raise ValueError(f"played_drivers: {car}: found {inputs!r}, expected pairs of a port and a key")


def drivers_of(wiring: Wiring) -> dict[str, str]:
    """The agents whose cars are driven, by the name of the driver's node."""
    return {wire.legs[0].publisher.node: wire.subject for wire in wiring.wires if wire.message == "command"}


def driver_ports(wiring: Wiring, played: PlayedDrivers | None = None) -> dict[str, tuple[tuple[str, str], ...]]:
    """By key, (car, port) of the drivers that use its messages; by the key "" those whose messages are left out.

    Ports are those of the driver: the estimates and the view that it receives, its route as it is sent, and its
    commands as the world receives them; "wanted": its commands as it sends them.

    played: of drivers that are played from a recording; they receive nothing, and nobody obeys them
    """
    drivers = drivers_of(wiring)
    ports: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for wire in wiring.wires:
        source = wire.legs[0]
        if wire.message in ("truth", "tracks", "view"):
            for leg in wire.every_leg:
                ports[leg.key] += [(drivers[end.node], end.port) for end in wire.receivers(leg) if end.node in drivers]
        elif wire.message == "route" and wire.subject in drivers:
            ports[source.key].append((drivers[wire.subject], "route"))
        elif wire.message == "command" and wire.subject not in (played or {}):
            for key in [leg.key for leg in wire.last_legs] or [""]:
                ports[key].append((wire.subject, "command"))
            ports[source.key].append((wire.subject, "wanted"))
    for car, inputs in (played or {}).items():
        for port, key in inputs:
            if (car, port) not in ports[key]:
                ports[key].append((car, port))
    return {key: tuple(ends) for key, ends in ports.items() if ends}
