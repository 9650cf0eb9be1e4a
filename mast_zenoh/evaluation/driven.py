"""What happened to the cars that drivers drove: from the truth, and from what their drivers received.

On which keys the messages of drivers are: what they drive by, and their commands to their cars.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.driving import Actuation, driver
from mast_zenoh.driving.braking import Belief, Commands
from mast_zenoh.driving.consequences import DrivenCar
from mast_zenoh.driving.driver import Refutations, upheld
from mast_zenoh.evaluation.effects import CODE
from mast_zenoh.evaluation.evaluation import Evaluation, ScoredFrames
from mast_zenoh.evaluation.run_data import ArrivedEstimate, Heard, Item, OwnView
from mast_zenoh.gather import LatestBefore
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.visibility import clear_in_view
from mast_zenoh.metrics.assignment import Places, find, nearest
from mast_zenoh.metrics.causes import ALTERED, ATTACK_CAUSES, MOVED, Hidden, joined_names
from mast_zenoh.metrics.driving import RoadUsers, vehicles
from mast_zenoh.metrics.estimates import TRUTH
from mast_zenoh.metrics.record import Snapshot
from mast_zenoh.metrics.scores import FALSE, MATCHED
from mast_zenoh.wiring.model import Wiring

#: m; an object that is nearer to a real one is that one, where the scores do not tell.
_SAME_M = 2.0
#: s; a manipulation of an object counts for so long, in which no estimate without it came.
_RECENT_S = 0.5
#: Effects on commands that change none of those that a car obeys; and those because of which one comes late or never.
_UNCHANGED, _WITHHELD = ("repeated", "unsettled"), ("delayed", "dropped")
#: m/s^2; a command that brakes harder than its driver wanted by less is the driver's.
_SAME_MPS2 = 0.3


def _held(arrivals: Mapping[int, Item], frames: Sequence[int]) -> Iterator[tuple[int, Item]]:
    """Yield (row, item) for each of some ascending frames: the newest that had arrived before it."""
    latest: LatestBefore[Item] = LatestBefore()
    waiting = deque(sorted(arrivals.items()))
    for row, frame in enumerate(frames):
        while waiting and waiting[0][0] < frame:
            step, item = waiting.popleft()
            latest.add(step, item, item.about)
        if (known := latest.get(frame)) is not None:
            yield row, known[1]


class _Believed(NamedTuple):
    """n objects that a driver believed in: where they are in each frame, their tracks, and what they are.

    informed: (f,) whether the driver had an estimate
    """

    objects: RoadUsers
    belief: Belief
    informed: Bools


class DrivenCars:
    """The driven cars of some frames of a run."""

    def __init__(self, scored: ScoredFrames, settings: Evaluation) -> None:
        self._scored, self._scores, self._data, self._settings = scored, scored.scores, scored.data, settings
        self._take_over = settings.take_over_frame(scored.data.period_s)

    def cars(self) -> dict[str, DrivenCar]:
        """What is known of each of them."""
        frames, truth = self._scores.frames, self._scores.truth
        row_of = {frame: row for row, frame in enumerate(frames.tolist())}
        result = {}
        for car, vehicle, objects, ids in vehicles(self._data.record.agents, truth, len(frames)):
            if car not in self._data.heard:
                continue
            heard, column = self._data.heard[car], self._data.record.agents.index(car)
            believed, (obeyed, refused) = self._believed(car, heard), self._obeyed(heard)
            of = np.array([row_of.get(frame, -1) for frame in obeyed])
            others = truth.boxes.id != truth.agent_object[truth.boxes.group, column]
            places = Places(believed.objects.frame, believed.objects.position)
            known = nearest(Places(objects.frame, objects.position), places, _SAME_M)[0] >= 0
            result[car] = DrivenCar(
                car=vehicle,
                objects=objects,
                ids=ids,
                seen=truth.points[others, column] >= self._settings.scorer.min_points,
                known=known,
                frames=frames,
                times_s=np.array([self._time_ns(frame) * 1e-9 for frame in frames.tolist()]),
                period_s=self._data.period_s,
                routes={row_of[frame]: route for frame, route in sorted(heard.routes.items()) if frame in row_of},
                believed=believed.objects,
                belief=believed.belief,
                commands=Commands(
                    of=of,
                    informed=believed.informed,
                    tampered=self._tampered(car, heard, obeyed, refused),
                    left_out=frozenset(heard.left_out),
                    first=int(frames.searchsorted(self._take_over)),
                ),
                look=self._settings.driving,
                on_truth=None if heard.on_truth is None else heard.on_truth.in_frames(frames),
            )
        return result

    def _time_ns(self, frame: int) -> int:
        return self._data.times_ns.get(frame, round(frame * self._data.period_s * 1e9))

    def _believed(self, car: str, heard: Heard) -> _Believed:
        """The objects of the estimates by which the car's driver drove in each frame, at the time of the frame."""
        rows = self._scores.every_series
        frame, about, series = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        position, parts = [np.zeros((0, 3))], [Snapshot.of(ObjectStates.empty())]
        informed = np.zeros(len(self._scores.frames), np.bool_)
        for row, held in self._used(car, heard):
            informed[row] = True
            for arrival, places, counts in held:
                number = -2 if arrival.estimate == TRUTH else rows.get((car, arrival.estimate), -1)
                parts.append(Snapshot._make(column[counts] for column in arrival.objects))
                position.append(places[counts])
                for columns, value in ((frame, row), (about, arrival.about), (series, number)):
                    columns.append(np.full(len(position[-1]), value))
        objects = Snapshot(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        moved = RoadUsers(np.concatenate(frame), np.concatenate(position), objects.velocity, objects.size, objects.yaw)
        return _Believed(moved, self._belief(objects, np.concatenate(about), np.concatenate(series)), informed)

    def _used(self, car: str, heard: Heard) -> Iterator[tuple[int, list[tuple[ArrivedEstimate, Floats, Bools]]]]:
        """Yield (row, estimates) for each frame in which the driver of a car had estimates to drive by.

        Of each estimate, where its n objects are at the time of the frame, (n, 3) m, and which of them count, (n,):
        with a veto not all.
        """
        held = {port: self._usable(car, arrivals) for port, arrivals in heard.estimates.items()}
        views, refutations = self._usable(car, heard.views), Refutations()
        for row in range(len(self._scores.frames)):
            now = {port: of_port[row] for port, of_port in held.items() if row in of_port}
            moved = {
                port: arrival.objects.position + arrival.objects.velocity * age_s
                for port, (arrival, age_s) in now.items()
            }
            counts = {port: np.ones(len(places), np.bool_) for port, places in moved.items()}
            if heard.has_veto:
                if not {"safety", "mission"} <= now.keys():
                    continue
                objects = now["mission"][0].objects
                free = _free(objects, moved["mission"], views.get(row))
                free = refutations.update(self._time_ns(int(self._scores.frames[row])), objects.id, free)
                counts["mission"] = upheld(moved["safety"], moved["mission"], free)
            if now:
                yield row, [(now[port][0], moved[port], counts[port]) for port in now]

    def _usable(self, car: str, arrivals: Mapping[int, Item]) -> dict[int, tuple[Item, float]]:
        """By row of the frames, what the driver held then and its age in s, where it is not too old."""
        numbers, limit_ns = (
            self._scores.frames.tolist(),
            round(self._settings.estimate_ages_s.get(car, driver.ESTIMATE_AGE_S) * 1e9),
        )
        ages = ((row, item, self._time_ns(numbers[row]) - item.time_ns) for row, item in _held(arrivals, numbers))
        return {row: (item, age_ns * 1e-9) for row, item, age_ns in ages if 0 <= age_ns <= limit_ns}

    def _belief(self, objects: Snapshot, about: Ints, series: Ints) -> Belief:
        """What n objects of estimates are. series: (n,) row of `Scores.series`, -1: not scored, -2: the truth"""
        judged, labels = self._scores.judged, self._scored.labels
        tracks = np.flatnonzero(judged.is_track)
        attacked = (judged.outcome == FALSE) & np.isin(labels.cause, range(len(ATTACK_CAUSES)))
        at = find((series, about, objects.id), (judged.series[tracks], judged.frame[tracks], judged.id[tracks]))
        row = np.append(tracks[self._mostly(tracks, attacked[tracks])], -1)[at]
        outcome = np.where(row >= 0, judged.outcome[row], -1) if len(tracks) else np.full(len(row), -1)
        there = self._scores.truth.boxes
        near, _ = nearest(Places(about, objects.position), Places(self._scores.truth_frame, there.position), _SAME_M)
        real = np.where(near >= 0, np.append(there.id, -1)[near], -1)
        real = np.where(series == -2, objects.id, real)
        matched = outcome == MATCHED
        real[matched] = judged.match_id[row[matched]]
        real[outcome == FALSE] = -1
        adversary = self._movers(real, about, series)
        shown = np.append(attacked, False)[row]
        adversary[shown] = labels.by[row[shown]]
        return Belief(objects.id, real, adversary)

    def _mostly(self, tracks: Ints, attacked: Bools) -> Ints:
        """(n,) which of n rows of tracks tells what each of them is: itself, or one of the same track around it.

        The latter where the track follows a lie in most of the frames around: what is not there can match a real object
        that passes through its place.

        tracks: (n,) rows of `Scores.judged`; attacked: (n,) which of them follow a lie
        """
        judged, around = self._scores.judged, round(_RECENT_S / self._data.period_s)
        series, id_, frame = judged.series[tracks], judged.id[tracks], judged.frame[tracks]
        order = np.lexsort((frame, id_, series))
        new = (np.diff(series[order], prepend=-1) != 0) | (np.diff(id_[order], prepend=-1) != 0)
        key = np.cumsum(new) * (int(frame.max(initial=0)) + 2 * around + 1) + frame[order]
        first, end = key.searchsorted(key - around), key.searchsorted(key + around, "right")
        lies = np.flatnonzero(attacked[order])
        before = np.concatenate([[0], np.cumsum(attacked[order])])
        result = np.arange(len(tracks))
        passed = ~attacked[order] & (2 * (before[end] - before[first]) > end - first)
        result[order[passed]] = order[lies[before[first[passed]]]]
        return result

    def _movers(self, real: Ints, about: Ints, series: Ints) -> np.ndarray:
        """(n,) str, who moved or changed each real object in the estimate, joined by "+"; "": nobody, or it is false.

        Shortly before the frame of the estimate, in a message that can have reached it.

        real: (n,) ids, -1: false; about: (n,) frames; series: (n,), as in `_belief`
        """
        names = self._scored.manipulations.culprits
        by = np.zeros((len(real), len(names)), np.bool_)
        rows = np.flatnonzero((real >= 0) & (series >= 0))
        most, own = round(_RECENT_S / self._data.period_s), np.zeros(0, np.bool_)
        hidden = Hidden.of(self._scored.manipulations)
        for kind, culprit, recently in hidden.recent(real[rows], about[rows], series[rows], own, most):
            if kind in (MOVED, ALTERED) and culprit >= 0:
                by[rows[recently], culprit] = True
        return joined_names(names, by)

    def _obeyed(self, heard: Heard) -> tuple[list[int], set[int]]:
        """By row of the frames, the frame whose command the car obeys until the next one; -1: it has none.

        And the frames whose commands it refuses.
        """
        limits = self._settings.car_limits
        actuation = Actuation(limits, round(self._settings.hold_s / self._data.period_s), limits.braking)
        waiting = deque(sorted(heard.commands, key=lambda arrival: arrival[0]))
        obeyed, refused = [], set()
        for frame in self._scores.frames.tolist():
            while waiting and waiting[0][0] <= frame:
                step, sent, command = waiting.popleft()
                if actuation.receive(sent, step, command):
                    refused.add(sent)
            obeyed.append(actuation.obeyed(frame + 1) if frame >= self._take_over else -1)
        return obeyed, refused

    def _tampered(self, car: str, heard: Heard, obeyed: Sequence[int], refused: Container[int]) -> list[str]:
        """By row of the frames, the adversaries because of which the car brakes as it does, joined by "+".

        Those that made the command that it obeys brake harder than its driver wanted. Of a car without a command, those
        that withheld that of the frame, or made one of it that the car refuses.

        obeyed: (f,) frame whose command the car obeys, -1: it has none; refused: frames whose commands it refuses
        """
        changed: dict[int, set[str]] = defaultdict(set)
        withheld: dict[int, set[str]] = defaultdict(set)
        effects = self._scored.effects
        counts = ~np.isin(effects.code, [CODE[name] for name in _UNCHANGED])
        withholds = np.isin(effects.code, [CODE[name] for name in _WITHHELD])
        for number, passage in enumerate(effects.passages):
            if (
                passage.message == "command"
                and passage.subject == car
                and self._data.roles.get(passage.node) == "adversary"
            ):
                own = counts & (effects.passage == number)
                for names, which in ((changed, own), (withheld, own & withholds)):
                    for frame in effects.frame[which].tolist():
                        names[frame].add(passage.node)
        accelerations = {frame: command.acceleration for _, frame, command in heard.commands}
        result = []
        for frame, of in zip(self._scores.frames.tolist(), obeyed, strict=True):
            if of < 0:
                names = changed if frame in refused else withheld
                by = names.get(frame, set()) if frame >= self._take_over else set()
            else:
                harder = heard.wanted.get(of, np.inf) - accelerations[of] > _SAME_MPS2
                by = changed.get(of, set()) if harder else set()
            result.append("+".join(sorted(by)))
        return result


def _free(objects: Snapshot, position: Floats, view: tuple[OwnView, float] | None) -> Bools:
    """Whether a view and its age show that the places of n objects are free, (n,), as the driver asks.

    position: (n, 3) m, of the objects at the time of the frame; None: the driver had no view
    """
    if view is None:
        return np.zeros(len(position), np.bool_)
    boxes = ClusterBoxes(position, objects.velocity, objects.size, objects.yaw)
    return clear_in_view(boxes, replace(view[0].view, age_s=view[1]))


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
