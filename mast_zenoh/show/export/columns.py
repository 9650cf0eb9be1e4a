"""Names, numbers, cameras and transforms that several formats share."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.arrays.states import CLASSES, Floats, ObjectStates
from mast_zenoh.errors import RunFolderError
from mast_zenoh.metrics.record import Series
from mast_zenoh.metrics.scores import OUTCOMES
from mast_zenoh.runs.frame import AgentPose, Frame
from mast_zenoh.runs.routes import TRUTH
from mast_zenoh.runs.run import Run
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Camera
from mast_zenoh.show.palette import OUTCOME_COLOURS, rgb
from mast_zenoh.wiring.plain_shapes import EXPECTED_NAME, is_name

#: Colours (4, 3), 0 to 255, of the outcomes of objects of the truth, and of tracks.
_TRUTH_COLOURS, _TRACK_COLOURS = (
    np.array([rgb(OUTCOME_COLOURS.get(f"{kind} {name}", OUTCOME_COLOURS["unevaluated"])) for name in OUTCOMES])
    for kind in ("truth", "track")
)


def stem(series: Series) -> str:
    """A name for files about a series: truth, picture, ego.local; raises RunFolderError if it is none."""
    name = ".".join(filter(None, series))
    if not is_name(name):
        raise RunFolderError(f"found {name!r:.120} as the name of an agent and its estimate, {EXPECTED_NAME}")
    return name


def class_names(states: ObjectStates) -> list[str]:
    """The classes of objects."""
    return [CLASSES[index] for index in states.class_id.tolist()]


def standard_deviations(states: ObjectStates) -> Floats:
    """(n, 9) of x y z l w h, m, and vx vy vz, m/s; NaN where the variance is negative."""
    variances = np.diagonal(states.covariance, axis1=1, axis2=2)
    return np.sqrt(np.where(variances >= 0.0, variances, np.nan))


def colours(frame: Frame, series: Series) -> NDArray[np.int64]:
    """(n, 3) red, green and blue, 0 to 255, of the objects of a series, by their outcomes."""
    table = _TRUTH_COLOURS if series == TRUTH else _TRACK_COLOURS
    return np.asarray(table[frame.outcomes[series].code], np.int64)


def missed(frame: Frame, series: Series) -> ObjectStates:
    """The objects of the truth that an estimate misses."""
    if TRUTH not in frame.objects:
        return ObjectStates.empty()
    return frame.objects[TRUTH].select(frame.truth_outcomes[series].code == OUTCOMES.index("missed"))


def wall_lines(scene: Recording) -> Floats:
    """(n, 2, 3) m: the upper edge of every wall of the buildings, the lower one at z = 0, and the corners."""
    segments = [np.zeros((0, 2, 3))]
    for outline, top in zip(scene.buildings, scene.building_height, strict=True):
        low = np.column_stack([outline, np.zeros(len(outline))])
        high = np.column_stack([outline, np.full(len(outline), top)])
        segments += [
            np.stack(ends, axis=1) for ends in ((low, np.roll(low, -1, 0)), (high, np.roll(high, -1, 0)), (low, high))
        ]
    return np.concatenate(segments)


#: Components in the axes of an image (x right, y down, z ahead) of a vector in ours (x ahead, y left, z up).
AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


#: Name of the world frame, and of the one of viewers with 32 bits for a coordinate, where that would be too coarse.
WORLD, SCENE = "world", "scene"


def scene_frame(run: Run) -> str:
    """The frame that has its origin at `run.origin`: the world's, unless the scene is far from its origin."""
    return SCENE if run.origin.any() else WORLD


def transforms_of(agent: str, pose: AgentPose, camera: Camera) -> Iterator[tuple[str, str, Floats, Floats]]:
    """(parent, child, position (3,) m, quaternion (4,) x y z w) of an agent and of its camera's optical frame."""
    mount = camera.mount_position, camera.mount_rotation @ AXES.T
    for parent, child, place in ((WORLD, agent, pose), (agent, f"{agent}/camera", mount)):
        yield parent, child, place[0], scalar_last(place[1])


def scalar_last(rotation: Floats) -> Floats:
    """The quaternion (4,) x y z w of a rotation (3, 3)."""
    return np.roll(quaternion_from_rotation(rotation), -1)


def cameras(run: Run) -> dict[str, Camera]:
    """The camera of each agent; the default one if the scene is not known."""
    known = {agent.name: agent.camera for agent in run.files.scene.agents} if run.files.scene is not None else {}
    return {agent: known.get(agent, Camera()) for agent in run.agents}
