"""One frame of a run, finished or running, as arrays in the world frame; and what viewers need of a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from mast_zenoh.arrays.geometry import rotation_from_quaternion, states_to_world
from mast_zenoh.arrays.states import Floats, Ints, ObjectStates
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.record import Series
from mast_zenoh.scenes.recording import Recording, truth_states
from mast_zenoh.viewer.evaluated import Changes, ChangeTable, Judgements, Outcomes, Score, ScoreTable
from mast_zenoh.viewer.routes import POSE, TRUTH


class Pose(NamedTuple):
    """Where an agent is. position: (3,) m;  rotation: (3, 3) active, agent to world"""

    position: Floats
    rotation: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame of a run.

    index:    its number;  time_ns: its time, ns since the scene began
    objects:  by series, the objects of the first valid message about this frame; a series without one is absent. Those
              of the truth have no covariance and no score
    outcomes: by series (also the truth), how the evaluator judged its objects: around its agent, or around the main
              agent if all agents share it. The truth is judged by the picture
    truth_outcomes: by series, how the evaluator judged the objects of the truth by it
    points:   (n, a) lidar returns of each object of the truth at each agent of the run
    own:      by agent, the id of its own object in the truth; -1: none
    poses:    by agent, its true pose
    scores:   by agent and estimate
    changes:  what interposers changed
    """

    index: int
    time_ns: int
    objects: Mapping[Series, ObjectStates]
    outcomes: Mapping[Series, Outcomes]
    truth_outcomes: Mapping[Series, Outcomes]
    points: Ints
    own: Mapping[str, int]
    poses: Mapping[str, Pose]
    scores: Mapping[Series, Score]
    changes: Changes


class FrameSource(Protocol):
    """Frames of a run, one after the other: `RunFrames` of a finished one, or those of a live one as they come.

    agents: their names, the main agent (`ego`) first;  topics: by series of objects, its key expression
    scored: agents and estimates with scores;  scene: buildings, sensors and cameras; None: not known
    name:   the run's own id

    All but the frames stay the same. Iterating over a live run blocks until there is a frame, and ends with the run.
    """

    @property
    def agents(self) -> tuple[str, ...]: ...
    @property
    def ego(self) -> str: ...
    @property
    def topics(self) -> Mapping[Series, str]: ...
    @property
    def scored(self) -> Sequence[Series]: ...
    @property
    def scene(self) -> Recording | None: ...
    @property
    def name(self) -> str: ...
    def __iter__(self) -> Iterator[Frame]: ...


def frame_of(
    run: FrameSource,
    index: int,
    time_ns: int,
    bodies: Mapping[Series, Body],
    judgements: Judgements,
    scores: ScoreTable,
    changes: ChangeTable,
) -> Frame:
    """A frame made of its messages and of what the evaluator says about it.

    bodies: columns of the first valid message of each series
    """
    objects = {series: _states(series, bodies[series]) for series in run.topics if series in bodies}
    ids = objects[TRUTH].id if TRUTH in objects else np.zeros(0, np.int64)
    truth = bodies.get(TRUTH, {})
    points = np.zeros((len(ids), len(run.agents)), np.int64)
    for column, agent in enumerate(truth["agents"].tolist() if truth else ()):
        if agent in run.agents:
            points[:, run.agents.index(agent)] = truth["points"][:, column]
    judged = {series: Series(series.agent or run.ego, series.estimator) for series in run.topics}
    by_truth = {series: judgements.of(index, judged[series], "truth", ids) for series in run.topics}
    by_truth[TRUTH] = next((by_truth[each] for each in by_truth if each.estimator == "picture"), by_truth[TRUTH])
    outcomes = {series: judgements.of(index, judged[series], "track", states.id) for series, states in objects.items()}
    return Frame(
        index,
        time_ns,
        objects,
        outcomes | {TRUTH: by_truth[TRUTH]},
        by_truth,
        points,
        dict(zip(truth["agents"].tolist(), truth["agent_object"].tolist(), strict=True)) if truth else {},
        {
            agent: Pose(body["position"], rotation_from_quaternion(body["rotation"]))
            for agent in run.agents
            if (body := bodies.get(Series(agent, POSE))) is not None
        },
        {series: score for series in run.scored if (score := scores.of(index, series)) is not None},
        changes.of(index),
    )


def _states(series: Series, body: Body) -> ObjectStates:
    """The objects of a message in the world frame."""
    if series == TRUTH:
        return truth_states(body)
    states = ObjectStates.from_columns(body)
    return states_to_world(states, body["origin"], body["rotation"]) if "origin" in body else states
