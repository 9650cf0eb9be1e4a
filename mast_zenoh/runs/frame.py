"""One frame of a run, finished or running: its objects in the world frame, and what the evaluator says about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.boxes import Boxes
from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_world
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.estimates import BEHIND_DOWNLINK, LOCAL
from mast_zenoh.metrics.record import Series
from mast_zenoh.runs.evaluated import MeasuredEffects, Outcomes, Score
from mast_zenoh.runs.files import boxes_of, rows
from mast_zenoh.runs.routes import POSE, TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes.recording import truth_states

#: Kinds of boxes, in drawing order: what they are, and how the evaluator judged them.
BOX_OUTCOMES = ("unevaluated", "truth matched", "track matched", "truth missed", "track false")


class AgentPose(NamedTuple):
    """Where an agent is. position: (3,) m;  rotation: (3, 3) active, agent to world"""

    position: Floats
    rotation: Floats


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a run.

    index:     its number;  time_ns: its time, ns since the scene began
    bodies:    by series, columns of the first valid message about it; {}: messages are not read
    refused:   number of messages about it that receivers refuse, in a running run
    estimates: of the main agent, whose `boxes` pictures show
    """

    run: Run
    index: int
    time_ns: int
    bodies: Mapping[Series, Body] = field(default_factory=dict)
    refused: int = 0
    estimates: tuple[str, ...] = ()

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
        return self.run.evaluated.outcomes(self.index, of_agent, kind, ids)

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
    def poses(self) -> dict[str, AgentPose]:
        """By agent, its true pose."""
        bodies = {agent: self.bodies.get(Series(agent, POSE)) for agent in self.run.agents}
        return {
            agent: AgentPose(body["position"], rotation_from_quaternion(body["rotation"]))
            for agent, body in bodies.items()
            if body is not None
        }

    @cached_property
    def scores(self) -> dict[Series, Score]:
        """By agent and estimate."""
        scores = {series: self.run.evaluated.score(self.index, series) for series in self.run.scored}
        return {series: score for series, score in scores.items() if score is not None}

    @cached_property
    def changes(self) -> MeasuredEffects:
        """What interposers changed."""
        return self.run.evaluated.changes(self.index)

    # -- from the tables of the main agent: what pictures show ---------------------------------------------------------

    @cached_property
    def boxes(self) -> dict[str, dict[str, Boxes]]:
        """The main agent's boxes by estimate, then by outcome (the keys of BOX_OUTCOMES)."""
        boxes: dict[str, dict[str, Boxes]] = {}
        here, scene = self.run.files.objects_of(self.index), self.run.files.scene
        if here is None:
            return boxes
        for estimate in self.estimates:
            if estimate == TRUTH.estimator and scene is not None:
                prepared = scene.truth_at(scene.nearest(self.index))
                truth = _states(TRUTH, self.bodies[TRUTH]) if TRUTH in self.bodies else prepared
                boxes[estimate] = dict.fromkeys(BOX_OUTCOMES, Boxes.join(()))
                boxes[estimate]["truth matched"] = Boxes.unnamed(truth.position, truth.size, truth.yaw)
                continue
            own = rows(here, here["estimator"] == self.run.original(estimate))
            boxes[estimate] = {}
            for outcome in BOX_OUTCOMES:
                kind, _, result = outcome.rpartition(" ")
                mask = own["outcome"] == result
                boxes[estimate][outcome] = boxes_of(rows(own, mask & (own["kind"] == kind) if kind else mask))
        return boxes

    @cached_property
    def before(self) -> MeasuredEffects:
        """Manipulations in transit to the command centre, visible in the picture and all later estimates."""
        return self._manipulations(downlink=False)

    @cached_property
    def behind(self) -> MeasuredEffects:
        """Manipulations of the picture in transit to the main agent."""
        return self._manipulations(downlink=True)

    def _manipulations(self, *, downlink: bool) -> MeasuredEffects:
        effects = self.run.manipulations
        if effects is None:
            return MeasuredEffects.none()
        here = rows(effects, (effects["frame"] == self.index) & ((effects["message"] == "picture") == downlink))
        if downlink:
            here = rows(here, np.isin(here["before_subscriber"].astype(str), ("", self.run.ego or "")))
        return MeasuredEffects.of(here)

    def marks(self, estimate: str) -> MeasuredEffects:
        """The manipulations in this frame that an estimate can show."""
        if estimate == LOCAL:
            return MeasuredEffects.none()
        return self.before.joined(self.behind) if estimate in BEHIND_DOWNLINK else self.before

    @property
    def time_label(self) -> str:
        """`t = 7.3 s (frame 73)`, or the frame alone where the scene is absent."""
        seconds = self.run.seconds(np.array([self.index]))
        return f"frame {self.index}" if seconds is None else f"t = {seconds[0]:.1f} s (frame {self.index})"


def frame_at(run: Run, index: int, estimates: Sequence[str]) -> Frame:
    """A frame as its tables have it, with these estimates of the main agent; without boxes where the run has none."""
    (time_s,) = run.times(np.array([index])).tolist()
    return Frame(run, index, round(time_s * 1e9), estimates=tuple(estimates))


def has_boxes(run: Run, estimate: str) -> bool:
    """Whether pictures can show an estimate."""
    return run.files.objects is not None and bool(np.any(run.files.objects["estimator"] == run.original(estimate)))


def ego_position(run: Run, frame: int) -> Floats | None:
    """(3,) m, where the ego is, or was last in a scene that is shorter; None: the scene is absent."""
    scene = run.files.scene
    if scene is None or run.ego not in scene.agent_names:
        return None
    return np.asarray(scene.agent_position[scene.nearest(frame), scene.agent_names.index(run.ego)], np.float64)


def _states(series: Series, body: Body) -> ObjectStates:
    """The objects of a message in the world frame."""
    if series == TRUTH:
        return truth_states(body)
    states = ObjectStates.from_columns(body)
    return states_to_world(states, body["origin"], body["rotation"]) if "origin" in body else states
