"""What happened to the cars that drivers drove: from the truth, and from what their drivers received."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.driving import Actuation, CarLimits, Command, driver
from mast_zenoh.driving.braking import Belief, Commands
from mast_zenoh.driving.consequences import DrivenCar
from mast_zenoh.driving.motion import RouteAhead
from mast_zenoh.driving.veto import Refutations, upheld
from mast_zenoh.effects import CODE, Effects
from mast_zenoh.evaluation.driver_on_truth import DriverOnTruth
from mast_zenoh.gather import LatestBefore
from mast_zenoh.integrity.base import ClusterBoxes
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import clear_in_view
from mast_zenoh.metrics import Driving, Scores
from mast_zenoh.metrics.boxes import Places, find, nearest
from mast_zenoh.metrics.causes import ATTACK_CAUSES, CauseLabels, Hidden, joined_names
from mast_zenoh.metrics.driving import RoadUsers, vehicles
from mast_zenoh.metrics.estimates import TRUTH
from mast_zenoh.metrics.manipulations import ALTERED, MOVED, Manipulations
from mast_zenoh.metrics.record import Record, Snapshot
from mast_zenoh.metrics.scores import FALSE, MATCHED

#: m; an object that is nearer to a real one is that one, where the scores do not tell.
_SAME_M = 2.0
#: s; a manipulation of an object counts for so long, in which no estimate without it came.
_RECENT_S = 0.5
#: Effects on commands that change none of those that a car obeys; and those because of which one comes late or never.
_UNCHANGED, _WITHHELD = ("repeated", "unsettled"), ("delayed", "dropped")
#: m/s^2; a command that brakes harder than its driver wanted by less is the driver's.
_SAME_MPS2 = 0.3


class ArrivedEstimate(NamedTuple):
    """An estimate as a driver received it.

    about: the frame that it describes; time_ns: ns, of that frame; estimate: its name among those that are scored
    """

    about: int
    time_ns: int
    estimate: str
    objects: Snapshot


class OwnView(NamedTuple):
    """What an agent's own sensor sees, as its driver received it; about, time_ns: as of an estimate."""

    about: int
    time_ns: int
    view: SweptView


Item = TypeVar("Item", ArrivedEstimate, OwnView)


@dataclass
class Heard:
    """What the driver of one car received.

    ports: on which it receives estimates and views; estimates: by port, those that arrived in each frame of the run
    views: by frame of arrival; routes: by frame
    commands: as they reached the car: the frame of arrival, and the command and its frame
    wanted: m/s^2, by frame, the acceleration of the commands as they left the driver
    left_out: ports whose messages a replay leaves out
    on_truth: its driver as it would drive on the truth; None: not known
    """

    ports: set[str] = field(default_factory=set)
    estimates: dict[str, dict[int, ArrivedEstimate]] = field(default_factory=lambda: defaultdict(dict))
    views: dict[int, OwnView] = field(default_factory=dict)
    routes: dict[int, RouteAhead] = field(default_factory=dict)
    commands: list[tuple[int, int, Command]] = field(default_factory=list)
    wanted: dict[int, float] = field(default_factory=dict)
    left_out: set[str] = field(default_factory=set)
    on_truth: DriverOnTruth | None = None

    def add(self, port: str, step: int, arrival: ArrivedEstimate) -> None:
        """Store an estimate that arrived in a frame of the run; of several the newest counts, as for the driver."""
        _keep_newest(self.estimates[port], step, arrival)

    def see(self, step: int, view: OwnView) -> None:
        """Store a view that arrived in a frame of the run, as estimates are."""
        _keep_newest(self.views, step, view)

    def obey(self, step: int, frame: int, command: Command) -> None:
        """Store a command of a frame that reached the car in a frame of the run."""
        self.commands.append((step, frame, command))

    def forget(self, before: int) -> None:
        """Forget what was received before a frame of the run, except what may still be the newest in it."""
        for port, arrivals in self.estimates.items():
            self.estimates[port] = _since(arrivals, before)
        self.views = _since(self.views, before)
        self.routes = {frame: route for frame, route in self.routes.items() if frame >= before}
        self.wanted = {frame: wanted for frame, wanted in self.wanted.items() if frame >= before}
        self.commands = [command for command in self.commands if command[0] >= before]

    @property
    def has_veto(self) -> bool:
        """Whether the agent's own sensors overrule its mission estimate: only then the driver receives views."""
        return "view" in self.ports


def _since(arrivals: Mapping[int, Item], first: int) -> dict[int, Item]:
    """The arrivals from a frame on, and the one before it that may still be the newest in it."""
    past = [step for step in arrivals if step < first]
    newest = max(past, key=lambda step: (arrivals[step].about, -step), default=first)
    return {step: item for step, item in arrivals.items() if step >= first or step == newest}


def _keep_newest(arrivals: dict[int, Item], step: int, item: Item) -> None:
    kept = arrivals.get(step)
    if kept is None or item.about > kept.about:
        arrivals[step] = item


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


@dataclass(frozen=True, eq=False)
class DrivenCars:
    """The driven cars of a run.

    manipulations: of objects, by interposers
    heard: by car;  ages_s: s, by car, the greatest age of an estimate that its driver uses, where it is not the default
    take_over, hold: frames, from which on, and for how many, the cars obey a command; limits: what they can do
    period_s: s, of a frame
    look:  the settings of the corridor
    """

    record: Record
    scores: Scores
    labels: CauseLabels
    effects: Effects
    manipulations: Manipulations
    roles: Mapping[str, str]
    heard: Mapping[str, Heard]
    ages_s: Mapping[str, float]
    take_over: int
    hold: int
    limits: CarLimits
    times_ns: Mapping[int, int]
    period_s: float
    min_points: int
    look: Driving

    def cars(self) -> dict[str, DrivenCar]:
        """What is known of each of them."""
        frames, truth = self.scores.frames, self.scores.truth
        row_of = {frame: row for row, frame in enumerate(frames.tolist())}
        result = {}
        for car, vehicle, objects, ids in vehicles(self.record.agents, truth, len(frames)):
            if car not in self.heard:
                continue
            heard, column = self.heard[car], self.record.agents.index(car)
            believed, (obeyed, refused) = self._believed(car, heard), self._obeyed(heard)
            of = np.array([row_of.get(frame, -1) for frame in obeyed])
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
                commands=Commands(
                    of=of,
                    informed=believed.informed,
                    tampered=self._tampered(car, heard, obeyed, refused),
                    left_out=frozenset(heard.left_out),
                    first=int(frames.searchsorted(self.take_over)),
                ),
                look=self.look,
                on_truth=None if heard.on_truth is None else heard.on_truth.in_frames(frames),
            )
        return result

    def _time_ns(self, frame: int) -> int:
        return self.times_ns.get(frame, round(frame * self.period_s * 1e9))

    def _believed(self, car: str, heard: Heard) -> _Believed:
        """The objects of the estimates by which the car's driver drove in each frame, at the time of the frame."""
        rows = self.scores.every_series
        frame, about, series = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        position, parts = [np.zeros((0, 3))], [Snapshot.of(ObjectStates.empty())]
        informed = np.zeros(len(self.scores.frames), np.bool_)
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
        for row in range(len(self.scores.frames)):
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
                free = refutations.update(self._time_ns(int(self.scores.frames[row])), objects.id, free)
                counts["mission"] = upheld(moved["safety"], moved["mission"], free)
            if now:
                yield row, [(now[port][0], moved[port], counts[port]) for port in now]

    def _usable(self, car: str, arrivals: Mapping[int, Item]) -> dict[int, tuple[Item, float]]:
        """By row of the frames, what the driver held then and its age in s, where it is not too old."""
        numbers, limit_ns = self.scores.frames.tolist(), round(self.ages_s.get(car, driver.ESTIMATE_AGE_S) * 1e9)
        ages = ((row, item, self._time_ns(numbers[row]) - item.time_ns) for row, item in _held(arrivals, numbers))
        return {row: (item, age_ns * 1e-9) for row, item, age_ns in ages if 0 <= age_ns <= limit_ns}

    def _belief(self, objects: Snapshot, about: Ints, series: Ints) -> Belief:
        """What n objects of estimates are. series: (n,) row of `Scores.series`, -1: not scored, -2: the truth"""
        judged, labels = self.scores.judged, self.labels
        tracks = np.flatnonzero(judged.is_track)
        attacked = (judged.outcome == FALSE) & np.isin(labels.cause, range(len(ATTACK_CAUSES)))
        at = find((series, about, objects.id), (judged.series[tracks], judged.frame[tracks], judged.id[tracks]))
        row = np.append(tracks[self._mostly(tracks, attacked[tracks])], -1)[at]
        outcome = np.where(row >= 0, judged.outcome[row], -1) if len(tracks) else np.full(len(row), -1)
        there = self.scores.truth.boxes
        near, _ = nearest(Places(about, objects.position), Places(self.scores.truth_frame, there.position), _SAME_M)
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
        judged, around = self.scores.judged, round(_RECENT_S / self.period_s)
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
        names = self.manipulations.culprits
        by = np.zeros((len(real), len(names)), np.bool_)
        rows = np.flatnonzero((real >= 0) & (series >= 0))
        most, own = round(_RECENT_S / self.period_s), np.zeros(0, np.bool_)
        hidden = Hidden.of(self.manipulations)
        for kind, culprit, recently in hidden.recent(real[rows], about[rows], series[rows], own, most):
            if kind in (MOVED, ALTERED) and culprit >= 0:
                by[rows[recently], culprit] = True
        return joined_names(names, by)

    def _obeyed(self, heard: Heard) -> tuple[list[int], set[int]]:
        """By row of the frames, the frame whose command the car obeys until the next one; -1: it has none.

        And the frames whose commands it refuses.
        """
        actuation = Actuation(self.limits, self.hold, self.limits.braking)
        waiting = deque(sorted(heard.commands, key=lambda arrival: arrival[0]))
        obeyed, refused = [], set()
        for frame in self.scores.frames.tolist():
            while waiting and waiting[0][0] <= frame:
                step, sent, command = waiting.popleft()
                if actuation.receive(sent, step, command):
                    refused.add(sent)
            obeyed.append(actuation.obeyed(frame + 1) if frame >= self.take_over else -1)
        return obeyed, refused

    def _tampered(self, car: str, heard: Heard, obeyed: Sequence[int], refused: Container[int]) -> list[str]:
        """By row of the frames, the adversaries because of which the car brakes as it does, joined by "+".

        Those that made the command that it obeys brake harder than its driver wanted. Of a car without a command, those
        that withheld that of the frame, or made one of it that the car refuses.

        obeyed: (f,) frame whose command the car obeys, -1: it has none; refused: frames whose commands it refuses
        """
        changed: dict[int, set[str]] = defaultdict(set)
        withheld: dict[int, set[str]] = defaultdict(set)
        effects = self.effects
        counts = ~np.isin(effects.code, [CODE[name] for name in _UNCHANGED])
        withholds = np.isin(effects.code, [CODE[name] for name in _WITHHELD])
        for number, passage in enumerate(effects.passages):
            if passage.message == "command" and passage.subject == car and self.roles.get(passage.node) == "adversary":
                own = counts & (effects.passage == number)
                for names, which in ((changed, own), (withheld, own & withholds)):
                    for frame in effects.frame[which].tolist():
                        names[frame].add(passage.node)
        accelerations = {frame: command.acceleration for _, frame, command in heard.commands}
        result = []
        for frame, of in zip(self.scores.frames.tolist(), obeyed, strict=True):
            if of < 0:
                names = changed if frame in refused else withheld
                by = names.get(frame, set()) if frame >= self.take_over else set()
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
