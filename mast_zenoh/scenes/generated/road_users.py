"""Road users of a generated junction: sizes, drivers and start positions."""

from __future__ import annotations

import numpy as np

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.generated.junction import BIKE, CROSSER, ROAD, WALKER
from mast_zenoh.scenes.generated.traffic import Movers, Network

# kind: user, class, (l, w, h) m smallest and largest, desired speed m/s, acceleration, braking m/s^2, headway s, gap m
_KINDS = {
    "car": (ROAD, "car", (4.0, 1.7, 1.4), (5.0, 1.95, 1.8), (10.5, 14.0), 1.6, 2.0, 1.2, 2.0),
    "truck": (ROAD, "truck", (7.0, 2.35, 2.8), (9.0, 2.5, 3.6), (9.5, 12.5), 1.0, 1.8, 1.5, 2.5),
    "bus": (ROAD, "bus", (11.0, 2.5, 3.0), (12.0, 2.5, 3.3), (9.5, 12.0), 1.0, 1.6, 1.5, 2.5),
    "bicycle": (BIKE, "bicycle", (1.7, 0.55, 1.6), (1.9, 0.7, 1.85), (4.0, 6.0), 0.9, 1.8, 1.0, 1.2),
    "crosser": (CROSSER, "pedestrian", (0.5, 0.5, 1.5), (0.7, 0.7, 1.9), (1.1, 1.6), 1.0, 1.5, 0.4, 0.5),
    "walker": (WALKER, "pedestrian", (0.5, 0.5, 1.5), (0.7, 0.7, 1.9), (0.9, 1.6), 1.0, 1.5, 0.4, 0.5),
}


def road_users(network: Network, count: dict[str, int], random: np.random.Generator) -> tuple[Movers, list[str]]:
    """Road users spread over the lanes, and the class name of each.

    count: number of "vehicle", "bicycle" and "pedestrian". Raises ConfigurationError if there is not enough room.
    """
    vehicle = random.choice(["car", "truck", "bus"], size=count["vehicle"], p=[0.84, 0.1, 0.06])
    vehicle[0] = "car"  # the ego needs a car
    pedestrian = random.choice(["crosser", "walker"], size=count["pedestrian"], p=[0.5, 0.5])
    names = [*vehicle, *["bicycle"] * count["bicycle"], *pedestrian]
    places = {user: _places(network, user, random) for user in (ROAD, BIKE, CROSSER, WALKER)}
    room = {user: len(free) for user, free in places.items()}
    long_places = [place for place in places[ROAD] if network.passable[place[0], 1]]
    rows: list[tuple[int, float]] = []
    for i, name in enumerate(names):
        user = _KINDS[name][0]
        free = long_places if name in ("truck", "bus") else places[user]
        if not free and user == CROSSER:  # no room at the crossings: a walker on the pavement instead
            names[i], user, free = "walker", WALKER, places[WALKER]
        elif not free and name in ("truck", "bus"):  # no lane passable for long vehicles: a car instead
            names[i], free = "car", places[ROAD]
        if not free:
            wanted = sum(_KINDS[k][0] == user for k in names)
            which = " motor vehicles, the ego and n_mobile among them" if user == ROAD else ""
            raise ConfigurationError(
                f"Intersection: no room for {wanted} x {names[i]}, expected at most {room[user]}{which}"
            )
        place = free[-1]
        for free_places in (places[user], long_places):
            if place in free_places:
                free_places.remove(place)
        rows.append(place)
    kinds = [_KINDS[name] for name in names]
    fraction = random.random((len(names), 4))
    low, high = np.array([kind[2] for kind in kinds]), np.array([kind[3] for kind in kinds])
    slow, fast = np.array([kind[4] for kind in kinds]).T
    acceleration, braking, headway, gap = np.array([kind[5:] for kind in kinds], np.float64).T
    movers = Movers(
        size=np.round(low + (high - low) * fraction[:, :3], 2),
        user=np.array([kind[0] for kind in kinds]),
        speed=slow + (fast - slow) * fraction[:, 3],
        acceleration=acceleration,
        braking=braking,
        headway=headway,
        gap=gap,
        path=np.array([path for path, _ in rows]),
        start=np.array([s for _, s in rows]),
    )
    return movers, [kind[1] for kind in kinds]


def _places(network: Network, user: int, random: np.random.Generator) -> list[tuple[int, float]]:
    """Start positions (path, m along it) of a kind of movers, shuffled.

    They do not overlap.
    """
    spacing = {ROAD: 18.0, BIKE: 8.0, CROSSER: 2.2, WALKER: 4.0}[user]
    places = []
    landings = 0
    for row, lane in enumerate(network.lanes):
        if lane.user == user and not lane.connector and (user == WALKER or network.passable[row].any()):
            begin = 0.5 * spacing if user == ROAD else 0.6
            room = lane.path.length - (spacing if user in (ROAD, WALKER) else 1.0)
            if user == CROSSER:
                # A crossing with two full landings would block: on every second landing, one place stays free.
                room -= spacing * (landings % 2)
                landings += 1
            places += [(row, float(s)) for s in np.arange(begin, room, spacing)]
    return [places[k] for k in random.permutation(len(places))]
