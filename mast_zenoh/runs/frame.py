"""One frame of a run, finished or running: its objects in the world frame, and what the evaluator says about them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_world
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.estimates import LOCAL, MISSION, PICTURE_ON_ARRIVAL, PICTURE_RECEIVED
from mast_zenoh.metrics.record import Series
from mast_zenoh.metrics.scores import OUTCOMES, UNEVALUATED
from mast_zenoh.run_folder.tables import from_arrow
from mast_zenoh.scenes.recording import truth_states
from mast_zenoh.runs.routes import POSE, TRUTH
from mast_zenoh.runs.run import RunRecord, Table, rows

#: Estimates behind the picture's way to the agent.
BEHIND = (MISSION, PICTURE_RECEIVED, PICTURE_ON_ARRIVAL)


#: Kinds of boxes, in drawing order: what they are, and how the evaluator judged them.
BOX_OUTCOMES = ("unevaluated", "truth matched", "track matched", "truth missed", "track false")


class Pose(NamedTuple):
    """Where an agent is. position: (3,) m;  rotation: (3, 3) active, agent to world"""

    position: Floats
    rotation: Floats


class Outcomes(NamedTuple):
    """How the evaluator judged n objects.

    code: (n,) index into metrics.scores.OUTCOMES; "unevaluated" also if it did not judge them, such as out of range
    match_id: (n,) id of the object that each was matched with, -1: none
    """

    code: Ints
    match_id: Ints

    @property
    def names(self) -> list[str]:
        """The outcome of each object as a word."""
        return [OUTCOMES[code] for code in self.code.tolist()]


class Score(NamedTuple):
    """Counts of objects of one estimate of an agent in a frame; rmse_m: m, NaN without a pair."""

    fn: int
    fp: int
    tp: int
    rmse_m: float
    id_switches: int

    @classmethod
    def of(cls, counts: Table, row: int) -> Score:
        """From a row of metrics.parquet."""
        fn, fp, tp, rmse_m, id_switches = (float(counts[name][row]) for name in cls._fields)
        return cls(int(fn), int(fp), int(tp), rmse_m, int(id_switches))


class Changes(NamedTuple):
    """n measured effects of interposers on messages about a frame.

    interposer, role, wire, effect: (n,) text, see docs/effects.md
    before, after: (n, 3) m, world frame; NaN where there was no object, or none after
    """

    interposer: NDArray[Any]
    role: NDArray[Any]
    wire: NDArray[Any]
    effect: NDArray[Any]
    before: Floats
    after: Floats

    @classmethod
    def of(cls, effects: Table) -> Changes:
        """From rows of attacks.parquet."""
        before, after = (
            np.stack([effects[f"{when}_{axis}"] for axis in "xyz"], axis=1).astype(np.float64)
            for when in ("before", "after")
        )
        return cls(effects["interposer"], effects["role"], effects["wire"], effects["effect"], before, after)

    @property
    def sentences(self) -> list[str]:
        """One line of text for each change."""
        lines = []
        for k in range(len(self.effect)):
            places = [
                f"{word} ({', '.join(f'{value:.1f}' for value in place[k])})"
                for word, place in (("from", self.before), ("to", self.after))
                if np.isfinite(place[k]).all()
            ]
            lines.append(" ".join([f"{self.interposer[k]} on {self.wire[k]}: {self.effect[k]}", *places]))
        return lines


class Marks(NamedTuple):
    """Manipulations in a frame, m, world frame.

    added:   (n, 3) where they inserted an object;  removed: (n, 3) where they took one away
    moved:   (n, 2, 3) from where to where they moved one
    """

    added: Floats
    removed: Floats
    moved: Floats

    @classmethod
    def of(cls, effects: Table | None) -> Marks:
        """From rows of attacks.parquet; None: no manipulations."""
        if effects is None:
            return cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2, 3)))
        changes = Changes.of(effects)
        kinds = [changes.effect == name for name in ("inserted", "removed", "moved")]
        moved = np.stack([changes.before[kinds[2]], changes.after[kinds[2]]], axis=1)
        return cls(changes.after[kinds[0]], changes.before[kinds[1]], moved)

    def inside(self, window: tuple[float, float, float]) -> Marks:
        """The marks inside a window: x, y and half the width in m."""
        x, y, half = window

        def within(places: Floats) -> Bools:
            return np.asarray(np.abs(places[..., :2] - [x, y]).max(axis=-1) <= half)

        moved = self.moved[within(self.moved).any(axis=-1)]
        return Marks(self.added[within(self.added)], self.removed[within(self.removed)], moved)

    def joined(self, other: Marks) -> Marks:
        """The union of two sets of marks."""
        return Marks(*(np.concatenate([own, others]) for own, others in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class Boxes:
    """n upright boxes in the world frame.

    position: (n, 3) m, of the centre; size: (n, 3) m, length, width, height; yaw: (n,) rad
    """

    position: Floats
    size: Floats
    yaw: Floats

    def __len__(self) -> int:
        return len(self.yaw)

    @classmethod
    def of(cls, table: Table) -> Boxes:
        """From rows with the columns of objects.parquet."""
        position, size = (
            np.stack([table[name] for name in names], axis=1).astype(np.float64) for names in ("xyz", "lwh")
        )
        return cls(position, size, table["yaw"].astype(np.float64))


class Evaluated:
    """Tables of the evaluator, grouped by frame.

    objects, counts, effects: objects.parquet, metrics.parquet, attacks.parquet; None: absent
    same_as: by agent, the estimate with the same messages of others

    Raises ValueError for unknown outcomes.
    """

    def __init__(
        self,
        objects: Table | None,
        counts: Table | None,
        effects: Table | None,
        same_as: Mapping[str, Mapping[str, str]],
    ) -> None:
        self._objects, self._same_as = objects, same_as
        outcomes = [] if objects is None else objects["outcome"].tolist()
        self._codes = np.array([OUTCOMES.index(name) for name in outcomes], np.int64)
        self._boxes = _grouped(objects, ("frame", "agent", "estimator", "kind"))
        self._counts, self._scores = counts, _grouped(counts, ("frame", "agent", "estimator"))
        self._effects, self._changes = effects, _grouped(effects, ("frame",))

    @property
    def series(self) -> list[Series]:
        """Agents and estimates with scores."""
        return list(dict.fromkeys(Series(agent, estimator) for _, agent, estimator in self._scores))

    def outcomes(self, frame: int, series: Series, kind: str, ids: Ints) -> Outcomes:
        """The outcomes of objects with ids (n,), in a frame, for an agent's estimate.

        kind: "track" for the objects of the estimate itself, "truth" for those of the scene
        """
        code, match = np.full(len(ids), UNEVALUATED, np.int64), np.full(len(ids), -1, np.int64)
        estimator = self._same_as.get(series.agent, {}).get(series.estimator, series.estimator)
        found = self._boxes.get((frame, series.agent, estimator, kind))
        if found is not None and self._objects is not None and len(ids):
            known = self._objects["id"][found]
            order = np.argsort(known, kind="stable")
            place = order[np.searchsorted(known, ids, sorter=order).clip(max=len(found) - 1)]
            judged = known[place] == ids
            code[judged] = self._codes[found[place[judged]]]
            match[judged] = self._objects["match_id"][found[place[judged]]]
        return Outcomes(code, match)

    def score(self, frame: int, series: Series) -> Score | None:
        """The score of an agent's estimate in a frame; None: not scored."""
        found = self._scores.get((frame, *series))
        return None if found is None or self._counts is None else Score.of(self._counts, int(found[0]))

    def changes(self, frame: int) -> Changes:
        """The changes of a frame."""
        if self._effects is None:
            text, places = np.zeros(0, str), np.zeros((0, 3))
            return Changes(text, text, text, text, places, places)
        found = self._changes.get((frame,), np.zeros(0, np.int64))
        return Changes.of({name: values[found] for name, values in self._effects.items()})


def _grouped(table: Table | None, names: Sequence[str]) -> dict[tuple[Any, ...], Ints]:
    """Ascending rows (k,) for each combination of values of some columns."""
    if table is None or not len(table[names[0]]):
        return {}
    values, codes = zip(*(np.unique(table[name], return_inverse=True) for name in names), strict=True)
    order = np.lexsort(codes[::-1])
    changes = np.any([np.diff(code[order]) != 0 for code in codes], axis=0).nonzero()[0] + 1
    groups = np.split(order, changes)
    keys = (tuple(v[code[found[0]]].item() for v, code in zip(values, codes, strict=True)) for found in groups)
    return dict(zip(keys, groups, strict=True))


@dataclass(frozen=True, eq=False)
class FramedRun(RunRecord, ABC):
    """A run with its frames one after the other: `RecordedRun` of a finished one, or `LiveRun` as they come."""

    @abstractmethod
    def __iter__(self) -> Iterator[Frame]:
        """The frames in order."""

    @property
    def main_agent(self) -> str:
        """`ego`, else the first."""
        return self.agents[0]

    @property
    def scored(self) -> Sequence[Series]:
        """Agents and estimates with scores, of those that have objects."""
        estimators = {series.estimator for series in self.topics}
        return [series for series in self.evaluated.series if series.estimator in estimators]

    @cached_property
    def evaluated(self) -> Evaluated:
        """The evaluator's tables by frame.

        Raises OSError, ValueError, KeyError, RunFolderError or ArrowException if objects.parquet cannot be used.
        """
        return Evaluated(from_arrow(self.read_objects()), self.counts, self.effects, self.metrics.get("same_as") or {})


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a run.

    index:     its number;  time_ns: its time, ns since the scene began
    bodies:    by series, columns of the first valid message about it; {}: messages are not read
    refused:   number of messages about it that receivers refuse, in a running run
    estimates: of the main agent, whose `boxes` pictures show
    window:    x, y and half the width in m, of the manipulations that pictures show, None: everywhere
    arrows:    whether pictures show moved objects

    Properties from messages need a FramedRun.
    """

    run: RunRecord
    index: int
    time_ns: int
    bodies: Mapping[Series, Body] = field(default_factory=dict)
    refused: int = 0
    estimates: tuple[str, ...] = ()
    window: tuple[float, float, float] | None = None
    arrows: bool = True

    # -- from the messages, with the evaluator's outcomes --------------------------------------------------------------

    @cached_property
    def objects(self) -> dict[Series, ObjectStates]:
        """The objects of each series in the world frame; a series without a message is absent.

        Those of the truth have no covariance and no score.
        """
        return {series: _states(series, self.bodies[series]) for series in self.run.topics if series in self.bodies}

    @cached_property
    def outcomes(self) -> dict[Series, Outcomes]:
        """How the evaluator judged the objects of each series, also of the truth.

        They are judged around their agent, or around the main agent if all agents share it; the truth by the picture.
        """
        judged = {series: self._judged(series, "track", states.id) for series, states in self.objects.items()}
        return judged | {TRUTH: self.truth_outcomes[TRUTH]}

    @cached_property
    def truth_outcomes(self) -> dict[Series, Outcomes]:
        """How the evaluator judged the objects of the truth by each series."""
        ids = self.objects[TRUTH].id if TRUTH in self.objects else np.zeros(0, np.int64)
        result = {series: self._judged(series, "truth", ids) for series in self.run.topics}
        result[TRUTH] = next((result[each] for each in result if each.estimator == "picture"), result[TRUTH])
        return result

    def _judged(self, series: Series, kind: str, ids: Ints) -> Outcomes:
        of_agent = Series(series.agent or self.run.agents[0], series.estimator)
        return self._evaluated.outcomes(self.index, of_agent, kind, ids)

    @property
    def _evaluated(self) -> Evaluated:
        assert isinstance(self.run, FramedRun)
        return self.run.evaluated

    @cached_property
    def points(self) -> Ints:
        """(n, a) lidar returns of each object of the truth at each agent of the run."""
        truth, agents = self.bodies.get(TRUTH, {}), self.run.agents
        points = np.zeros((len(self.objects[TRUTH]) if truth else 0, len(agents)), np.int64)
        for place, agent in enumerate(truth["agents"].tolist() if truth else ()):
            if agent in agents:
                points[:, agents.index(agent)] = truth["points"][:, place]
        return points

    @property
    def own(self) -> dict[str, int]:
        """By agent, the id of its own object in the truth; -1: none."""
        truth = self.bodies.get(TRUTH, {})
        return dict(zip(truth["agents"].tolist(), truth["agent_object"].tolist(), strict=True)) if truth else {}

    @cached_property
    def poses(self) -> dict[str, Pose]:
        """By agent, its true pose."""
        bodies = {agent: self.bodies.get(Series(agent, POSE)) for agent in self.run.agents}
        return {
            agent: Pose(body["position"], rotation_from_quaternion(body["rotation"]))
            for agent, body in bodies.items()
            if body is not None
        }

    @cached_property
    def scores(self) -> dict[Series, Score]:
        """By agent and estimate."""
        assert isinstance(self.run, FramedRun)
        scores = {series: self._evaluated.score(self.index, series) for series in self.run.scored}
        return {series: score for series, score in scores.items() if score is not None}

    @cached_property
    def changes(self) -> Changes:
        """What interposers changed."""
        return self._evaluated.changes(self.index)

    # -- from the tables of the main agent: what pictures show ---------------------------------------------------------

    @cached_property
    def boxes(self) -> dict[str, dict[str, Boxes]]:
        """The main agent's boxes by estimate, then by outcome (the keys of BOX_OUTCOMES)."""
        boxes: dict[str, dict[str, Boxes]] = {}
        objects, scene = self.run.objects, self.run.recording
        if objects is None:
            return boxes
        here = rows(objects, objects["frame"] == self.index)
        for estimate in self.estimates:
            if estimate == TRUTH.estimator and scene is not None:
                prepared = scene.truth_at(min(self.index, len(scene) - 1))
                truth = _states(TRUTH, self.bodies[TRUTH]) if TRUTH in self.bodies else prepared
                nothing = Boxes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
                boxes[estimate] = dict.fromkeys(BOX_OUTCOMES, nothing)
                boxes[estimate]["truth matched"] = Boxes(truth.position, truth.size, truth.yaw)
                continue
            own = rows(here, here["estimator"] == self.run.original(estimate))
            boxes[estimate] = {}
            for outcome in BOX_OUTCOMES:
                kind, _, result = outcome.rpartition(" ")
                mask = own["outcome"] == result
                boxes[estimate][outcome] = Boxes.of(rows(own, mask & (own["kind"] == kind) if kind else mask))
        return boxes

    @cached_property
    def before(self) -> Marks:
        """Manipulations in transit to the command centre, visible in the picture and all later estimates."""
        return self._marks(downlink=False)

    @cached_property
    def behind(self) -> Marks:
        """Manipulations of the picture in transit to the main agent."""
        return self._marks(downlink=True)

    def _marks(self, *, downlink: bool) -> Marks:
        effects = self.run.attacks
        if effects is None:
            return Marks.of(None)
        here = rows(effects, (effects["frame"] == self.index) & ((effects["message"] == "picture") == downlink))
        if downlink:
            here = rows(here, np.isin(here["before_subscriber"].astype(str), ("", self.run.ego or "")))
        marks = Marks.of(here)
        marks = marks if self.arrows else marks._replace(moved=np.zeros((0, 2, 3)))
        return marks if self.window is None else marks.inside(self.window)

    def marks(self, estimate: str) -> Marks:
        """The manipulations in this frame that an estimate can show."""
        if estimate == LOCAL:
            return Marks.of(None)
        return self.before.joined(self.behind) if estimate in BEHIND else self.before

    @property
    def time_label(self) -> str:
        """`t = 7.3 s (frame 73)`, or the frame alone where the scene is absent."""
        seconds = self.run.seconds(np.array([self.index]))
        return f"frame {self.index}" if seconds is None else f"t = {seconds[0]:.1f} s (frame {self.index})"


def frame_at(run: RunRecord, index: int, estimates: Sequence[str]) -> Frame:
    """A frame as its tables have it, with these estimates of the main agent; without boxes where the run has none."""
    seconds = run.seconds(np.array([index]))
    time_s = index * run.period_s if seconds is None else float(seconds[0])
    return Frame(run, index, round(time_s * 1e9), estimates=tuple(estimates))


def has_boxes(run: RunRecord, estimate: str) -> bool:
    """Whether pictures can show an estimate."""
    return run.objects is not None and bool(np.any(run.objects["estimator"] == run.original(estimate)))


def ego_position(run: RunRecord, frame: int) -> Floats | None:
    """(3,) m, where the ego is; None: the scene is absent or the frame is not in it."""
    if run.recording is None or run.ego not in run.recording.agent_names or not 0 <= frame < len(run.recording):
        return None
    return np.asarray(run.recording.agent_position[frame, run.recording.agent_names.index(run.ego)], np.float64)


def _states(series: Series, body: Body) -> ObjectStates:
    """The objects of a message in the world frame."""
    if series == TRUTH:
        return truth_states(body)
    states = ObjectStates.from_columns(body)
    return states_to_world(states, body["origin"], body["rotation"]) if "origin" in body else states
