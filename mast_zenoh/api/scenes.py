"""Scenes without a run: ground truth, agents' poses and detections."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow

from mast_zenoh import scenario as scenarios
from mast_zenoh import scenes
from mast_zenoh.arrays.geometry import quaternion_from_rotation
from mast_zenoh.config import registry
from mast_zenoh.config.registry import has_short_name, recognised
from mast_zenoh.config.settings import nested
from mast_zenoh.errors import ConfigurationError, SceneError, nearest
from mast_zenoh.runs import messages as recorded
from mast_zenoh.runs.messages import Columns
from mast_zenoh.scenario.reading import RUN_DEFAULTS
from mast_zenoh.scenes import Recording, inspection
from mast_zenoh.scenes.making.sensor_types import SensorsByAgent
from mast_zenoh.scenes.own_detections import write_detections
from mast_zenoh.sensing import Detector

if TYPE_CHECKING:
    from mast_zenoh.show.figures.style import Figure

#: Arguments of `scenes.from_arrays`, and those of them that are needed.
_ARRAYS = tuple(inspect.signature(scenes.from_arrays).parameters)
_OF_ARRAYS = ("times_s", "position")
#: Those that may be plain dicts, and what they stand for.
_BUILT: dict[str, Any] = {"sensors": SensorsByAgent | None, "detector": Detector}


class PreparedScene:
    """A scene prepared with one seed, exactly as runs with this seed play it.

    recording: all of it as arrays
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.recording.name

    @property
    def agents(self) -> tuple[str, ...]:
        """The names of the agents, the ego first."""
        return self.recording.agent_names

    @property
    def truth(self) -> pyarrow.Table:
        """A row per frame and object, world frame: columns as `Run.truth`."""
        scene = self.recording
        return self._table(
            lambda frame: recorded.truth(scene.truth_at(frame).columns() | {"points": scene.points_at(frame)})
        )

    def agent(self, name: str) -> PreparedAgent:
        """One of the agents. Raises ConfigurationError for a name that none has."""
        if name not in self.agents:
            raise ConfigurationError(f"{self.name}: no agent {name!r} in this scene{nearest(name, self.agents)}")
        return PreparedAgent(self, name)

    def _table(self, rows: Callable[[int], Columns], age_ns: Callable[[int], int] = lambda _: 0) -> pyarrow.Table:
        """A table of the rows that `rows` makes of each frame; age_ns: ns, by which they are older than it"""
        times_ns = (self.recording.times_ns - self.recording.times_ns[0]).tolist()

        def parts() -> Iterator[tuple[int, float, Columns]]:
            for frame, time_ns in enumerate(times_ns):
                yield frame, (time_ns - age_ns(frame)) * 1e-9, rows(frame)

        return recorded.table(parts())

    def save(self, path: str | Path) -> Path:
        """Write the scene to a file (.npz), and return its path; a scenario plays it as scene="recording:PATH".

        Raises SceneError if it cannot be written.
        """
        target = Path(path)
        try:
            self.recording.save(target)
        except OSError as error:
            raise SceneError(f"{target}: cannot be written: {error}") from error
        return target

    def save_detections(self, folder: str | Path) -> list[Path]:
        """Write the detections as KITTI text, a file for each agent in a new or empty folder, and return the files.

        `scene.detections=FOLDER` replays them (docs/tutorial-own-data.md). Raises SceneError if they cannot be written.
        """
        target = Path(folder)
        try:
            target.mkdir(parents=True, exist_ok=True)
            if any(target.iterdir()):
                raise SceneError(f"{target}: is not empty, expected a new or empty folder")
            return [write_detections(target, name, self.recording, row) for row, name in enumerate(self.agents)]
        except OSError as error:
            raise SceneError(f"{target}: cannot be written: {error}") from error

    @property
    def description(self) -> str:
        """What the scene contains, and what is suspicious about it, as lines of text."""
        rows = [("scene", self.name), *inspection.contents(self.recording)]
        suspicious = [("suspicious", each) for each in inspection.problems(self.recording)]
        return "\n".join(f"{name:12}{text}" for name, text in [*rows, *suspicious])

    def birdseye(self, frame: int = 0) -> Figure:
        """A figure of a frame from above: what the agents see, detections, and the agents with their ranges.

        Raises ConfigurationError for a frame that the scene does not have.
        """
        if not 0 <= frame < len(self):
            raise ConfigurationError(f"{self.name}: frame is {frame}, expected 0 to {len(self) - 1}")
        from mast_zenoh.show.figures.scene import scene_figure  # Matplotlib takes longer than preparing a scene

        return scene_figure(self.recording, frame)

    def __len__(self) -> int:
        return len(self.recording)

    def __repr__(self) -> str:
        return f"<Scene {self.name}: {len(self)} frames, agents {', '.join(self.agents)}>"


class PreparedAgent:
    """The pose and detections of one agent of a scene."""

    def __init__(self, scene: PreparedScene, name: str) -> None:
        self.name = name
        self._scene = scene
        self._index = scene.agents.index(name)

    @property
    def pose(self) -> pyarrow.Table:
        """A row per frame: columns as `Agent.pose` of a run."""
        scene, index = self._scene.recording, self._index
        rotation = quaternion_from_rotation(scene.agent_rotation[:, index])
        return self._scene._table(
            lambda frame: recorded.pose(
                {
                    "position": scene.agent_position[frame, index],
                    "rotation": rotation[frame],
                    "velocity": scene.agent_velocity[frame, index],
                }
            )
        )

    @property
    def detections(self) -> pyarrow.Table:
        """A row per frame and detection, in sensor coordinates.

        Columns as `Agent.detections` of a run.

        `truth_id`: id of the detected object; -1 for clutter. No agent ever sees it.
        `time_s` is the time of the measurement. Of several sensors: those of the first.
        """
        return self._detections(0)

    def detections_of(self, sensor: str) -> pyarrow.Table:
        """As `detections`, of one of several sensors. Raises ConfigurationError for a name that none has."""
        names = [each.name for each in self._scene.recording.agents[self._index].sensors]
        if sensor not in names:
            raise ConfigurationError(f"{self.name}: no sensor {sensor!r}{nearest(sensor, names)}")
        return self._detections(names.index(sensor))

    def _detections(self, row: int) -> pyarrow.Table:
        """The detections of a sensor, by its row among those of the agent."""
        scene, index = self._scene.recording, self._index
        return self._scene._table(
            lambda frame: (
                recorded.detections(scene.detections_at(frame, index, row).columns())
                | {"truth_id": np.asarray(scene.detection_truth_id_at(frame, index, row))}
            ),
            lambda frame: max(0, scene.age_ns_at(frame, index, row)),
        )

    def __repr__(self) -> str:
        return f"<Agent {self.name} of {self._scene.name}: pose, detections>"


def prepare(
    scene: str | Path | Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    frames: int | None = None,
    **parameters: Any,
) -> PreparedScene:
    """Prepare a scene without running anything.

    scene:      a short name ("intersection:2", "av2:PATH", …), a dict(type=…) with the parameters of a scene, the
                Python file of a scenario, whose scene it is, or a file of `save` or scene.npz of a run; None: from
                arrays, `mast.scene(times_s=…, position=…)` (docs/how-to-scenes.md), and without any, "intersection"
    seed:       seed of its random draws; None: the scenario's seed, otherwise 0
    frames:     number of frames; None: all of the scene
    parameters: of the scene; with a file, of its `scenario` function

    Raises ConfigurationError, and SceneError for missing or damaged data.
    """
    if scene is None and parameters.keys() & _OF_ARRAYS:
        _check_arguments(parameters)
        for name in parameters.keys() & _BUILT.keys():
            parameters[name] = registry.built(parameters[name], _BUILT[name], f"scene: {name}")
        return PreparedScene(scenes.from_arrays(**parameters, seed=seed or 0, frames=frames))
    scene = "intersection" if scene is None else scene
    named_so = isinstance(scene, Mapping) or has_short_name(str(scene))
    suffix = "" if named_so else Path(str(scene)).suffix
    if suffix == ".npz":
        options = {"seed": seed, "frames": frames} | parameters
        if unused := [name for name, value in options.items() if value is not None]:
            raise ConfigurationError(f"{scene}: is recorded already: found {', '.join(unused)}, expected nothing else")
        return PreparedScene(Recording.load(Path(str(scene)).resolve()))
    run = RUN_DEFAULTS
    if suffix == ".py":
        _, content = scenarios.load_values(str(scene), parameters)
        run = run | dict(content.get("run", {}))
        spec = scenarios.choose_scene(content.get("scene", "intersection"))
    else:
        spec = scenarios.choose_scene(scene if isinstance(scene, Mapping) else str(scene), **parameters)
    built = registry.build(spec, scenes.Scene, "scene")
    recording = scenes.prepare(built, run["seed"] if seed is None else seed, frames, json.dumps(spec, sort_keys=True))
    return PreparedScene(recording)


def named(
    scene: str, settings: Sequence[str] = (), *, seed: int | None = None, frames: int | None = None
) -> PreparedScene:
    """The scene of a short name, or of a file or folder, whose type is recognised.

    settings: `key=value`, parameters of the scene; `scene.` before a key, as for a run, may be there or not
    """
    parameters = nested([setting.removeprefix("scene.") for setting in settings])
    if "scene" in parameters:
        raise ConfigurationError(
            f"scene: found {parameters['scene']!r} in the settings, expected it as the argument only"
        )
    return prepare(recognised(scene), seed=seed, frames=frames, **parameters)


def _check_arguments(parameters: Mapping[str, Any]) -> None:
    """Raise ConfigurationError for a missing or unknown argument of a scene from arrays."""
    for name in parameters:
        if name not in _ARRAYS:
            raise ConfigurationError(f"scene: from arrays has no parameter {name!r}{nearest(name, _ARRAYS)}")
    for name in _OF_ARRAYS:
        if name not in parameters:
            raise ConfigurationError(f"scene: {name} is missing, expected {' and '.join(_OF_ARRAYS)}")
