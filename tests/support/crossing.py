"""Batches of five agents around a crossing, with phantoms, hidden cars, and views that end before them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from integrity_batches import STEP_NS, Track, batch, view

from mast_zenoh.integrity import Batch

Place = tuple[float, float]
#: Five agents around a crossing, and a car that all of them see.
PLACES: dict[str, Place] = {"a": (-25.0, 0.0), "b": (25.0, 0.0), "c": (0.0, 25.0), "d": (0.0, -25.0), "e": (18.0, 18.0)}
CAR: Place = (6.0, 6.0)


def world(
    phantoms: Mapping[str, Sequence[Place]] | None = None,
    hidden: Mapping[str, Sequence[Place]] | None = None,
    cars: Sequence[Place] = (CAR,),
    sees: Mapping[Place, str] | None = None,
    frames: int = 50,
) -> Iterable[Batch]:
    """Batches of five agents that see cars.

    phantoms: by liar, what it reports besides, and where its view ends; hidden: by liar, cars that it sees through
    sees: by place, the agents that can look there; all others have something before it. Default: all
    """
    phantoms, hidden, sees = phantoms or {}, hidden or {}, sees or {}
    places = list(dict.fromkeys([*cars, *(place for own in phantoms.values() for place in own)]))
    for frame in range(frames):
        tracks: list[Track] = []
        views = {}
        for name, place in PLACES.items():
            blocked = []
            for cluster, where in enumerate(places):
                looks = name in sees.get(where, "abcde")
                claimed = where in phantoms.get(name, ())
                real = where in cars and where not in hidden.get(name, ())
                if (looks and real) or claimed:
                    tracks.append((name, cluster, where))
                    blocked.append((*where, 2.5))
                elif not looks:
                    before = (0.8 * where[0] + 0.2 * place[0], 0.8 * where[1] + 0.2 * place[1])
                    blocked.append((*before, 2.5))
            views[name] = view(place, *blocked)
        yield batch(tracks, tuple(PLACES), views, frame=frame)


def later(batches: Iterable[Batch], frames: int) -> Iterable[Batch]:
    """Batches, so many frames later."""
    return (replace(each, time_ns=each.time_ns + frames * STEP_NS) for each in batches)
