"""What happened to the cars that drivers drove: from the truth, and from what their drivers received."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Ints, ObjectStates
from mast_zenoh.driving import driver
from mast_zenoh.driving.braking import Belief
from mast_zenoh.driving.consequences import DrivenCar, consequences, course
from mast_zenoh.driving.motion import RouteAhead
from mast_zenoh.effects import Effects
from mast_zenoh.gather import LatestBefore
from mast_zenoh.metrics import Driving, Scores, Table
from mast_zenoh.metrics.boxes import Places, find, nearest
from mast_zenoh.metrics.causes import ATTACK_CAUSES, Labels
from mast_zenoh.metrics.driving import Objects, vehicles
from mast_zenoh.metrics.estimates import TRUTH
from mast_zenoh.metrics.record import Record, Snapshot
from mast_zenoh.metrics.scores import FALSE, MATCHED

#: m; an object that is nearer to a real one is that one, where the scores do not tell.
_SAME_M = 2.0


class Arrival(NamedTuple):
    """An estimate as a driver received it.

    estimate: its name; about: the frame that it describes; time_ns: ns, of that frame
    """

    estimate: str
    about: int
    time_ns: int
    objects: Snapshot


@dataclass
class Heard:
    """What the driver of one car received.

    estimates: by name, those that arrived in each frame of the run; routes: by frame
    """

    estimates: dict[str, dict[int, Arrival]] = field(default_factory=lambda: defaultdict(dict))
    routes: dict[int, RouteAhead] = field(default_factory=dict)

    def add(self, step: int, arrival: Arrival) -> None:
        """Store an estimate that arrived in a frame of the run; of several the newest counts, as for the driver."""
        kept = self.estimates[arrival.estimate].get(step)
        if kept is None or arrival.about > kept.about:
            self.estimates[arrival.estimate][step] = arrival

    def held(self, frames: Sequence[int]) -> Iterator[tuple[int, Arrival]]:
        """Yield (row, estimate) for each of some ascending frames: the newest that had arrived before it."""
        for arrivals in self.estimates.values():
            latest: LatestBefore[Arrival] = LatestBefore()
            waiting = sorted(arrivals.items())
            for row, frame in enumerate(frames):
                while waiting and waiting[0][0] < frame:
                    step, arrival = waiting.pop(0)
                    latest.add(step, arrival, arrival.about)
                if (known := latest.get(frame)) is not None:
                    yield row, known[1]


class _Believed(NamedTuple):
    """n objects that a driver believed in: where they are in each frame, their tracks, and what they are."""

    objects: Objects
    belief: Belief


@dataclass(frozen=True, eq=False)
class DrivenCars:
    """The driven cars of a run.

    heard: by car;  ages_s: s, by car, the greatest age of an estimate that its driver uses, where it is not the default
    period_s: s, of a frame
    look:  the settings of the corridor
    """

    record: Record
    scores: Scores
    labels: Labels
    effects: Effects
    roles: Mapping[str, str]
    heard: Mapping[str, Heard]
    ages_s: Mapping[str, float]
    times_ns: Mapping[int, int]
    period_s: float
    min_points: int
    look: Driving

    def results(self) -> tuple[dict[str, Any], Table]:
        """What happened to each car ("driven" of metrics.json), and the columns of driven.parquet."""
        cars = self._cars()
        courses = {car: course(driven) for car, driven in cars.items()}
        table: Table = {
            "agent": np.repeat(np.array([*courses], object), [len(each["frame"]) for each in courses.values()])
        }
        for name in next(iter(courses.values()), {}):
            table[name] = np.concatenate([each[name] for each in courses.values()])
        return {car: consequences(driven) for car, driven in cars.items()}, table

    def _cars(self) -> dict[str, DrivenCar]:
        frames, truth = self.scores.frames, self.scores.truth
        row_of = {frame: row for row, frame in enumerate(frames.tolist())}
        result = {}
        for car, vehicle, objects, ids in vehicles(self.record.agents, truth, len(frames)):
            if car not in self.heard:
                continue
            heard, column = self.heard[car], self.record.agents.index(car)
            believed = self._believed(car, heard)
            others = truth.boxes.id != truth.agent_object[truth.boxes.group, column]
            places = Places(believed.objects.frame, believed.objects.position)
            known = nearest(Places(objects.frame, objects.position), places, _SAME_M)[0] >= 0
            result[car] = DrivenCar(
                car=vehicle,
                objects=objects,
                ids=ids,
                seen=truth.points[others, column] >= self.min_points,
                known=known,
                frames=frames,
                times_s=np.array([self._time_ns(frame) * 1e-9 for frame in frames.tolist()]),
                period_s=self.period_s,
                routes={row_of[frame]: route for frame, route in sorted(heard.routes.items()) if frame in row_of},
                believed=believed.objects,
                belief=believed.belief,
                tampered=self._tampered(car),
                look=self.look,
            )
        return result

    def _time_ns(self, frame: int) -> int:
        return self.times_ns.get(frame, round(frame * self.period_s * 1e9))

    def _believed(self, car: str, heard: Heard) -> _Believed:
        """The objects of the estimates that the car's driver held in each frame, moved on to the time of the frame."""
        numbers = self.scores.frames.tolist()
        frames, age, about, series, parts = [], [], [], [], [Snapshot.of(ObjectStates.empty())]
        rows = self.scores.every_series
        for row, arrival in sorted(heard.held(numbers), key=lambda item: item[0]):
            age_s = (self._time_ns(numbers[row]) - arrival.time_ns) * 1e-9
            count = len(arrival.objects.id)
            if not 0.0 <= age_s <= self.ages_s.get(car, driver.ESTIMATE_AGE_S) or count == 0:
                continue
            parts.append(arrival.objects)
            frames += [row] * count
            age += [age_s] * count
            about += [arrival.about] * count
            series += [-2 if arrival.estimate == TRUTH else rows.get((car, arrival.estimate), -1)] * count
        objects = Snapshot(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        position = objects.position + objects.velocity * np.array(age).reshape(-1, 1)
        frame = np.array(frames, np.int64)
        moved = Objects(frame, position, objects.velocity, objects.size, objects.yaw)
        belief = self._belief(objects, np.array(about, np.int64), np.array(series, np.int64))
        return _Believed(moved, belief)

    def _belief(self, objects: Snapshot, about: Ints, series: Ints) -> Belief:
        """What n objects of estimates are. series: (n,) row of `Scores.series`, -1: not scored, -2: the truth"""
        judged, labels = self.scores.judged, self.labels
        tracks = np.flatnonzero(judged.is_track)
        at = find((series, about, objects.id), (judged.series[tracks], judged.frame[tracks], judged.id[tracks]))
        row = np.append(tracks, -1)[at]
        outcome = np.where(row >= 0, judged.outcome[row], -1) if len(tracks) else np.full(len(row), -1)
        there = self.scores.truth.boxes
        near, _ = nearest(Places(about, objects.position), Places(self.scores.truth_frame, there.position), _SAME_M)
        real = np.where(near >= 0, np.append(there.id, -1)[near], -1)
        real = np.where(series == -2, objects.id, real)
        matched = outcome == MATCHED
        real[matched] = judged.match_id[row[matched]]
        real[outcome == FALSE] = -1
        adversary = np.full(len(row), "", object)
        attacked = (outcome == FALSE) & (row >= 0)
        attacked[attacked] = np.isin(labels.cause[row[attacked]], range(len(ATTACK_CAUSES)))
        adversary[attacked] = labels.by[row[attacked]]
        return Belief(objects.id, real, adversary)

    def _tampered(self, car: str) -> list[str]:
        """By row of the frames, the adversaries that changed the car's command, joined by "+"."""
        names: dict[int, set[str]] = defaultdict(set)
        effects = self.effects
        for number, passage in enumerate(effects.passages):
            if passage.message == "command" and passage.subject == car and self.roles.get(passage.node) == "adversary":
                for frame in effects.frame[effects.passage == number].tolist():
                    names[frame].add(passage.node)
        return ["+".join(sorted(names[frame])) if frame in names else "" for frame in self.scores.frames.tolist()]
