"""Scenes of OPV2V, V2XSet, V2X-Real and V2V4Real."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.base import Scene
from mast_zenoh.scenes.making.assembly import assemble
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.making.visibility import listed_returns
from mast_zenoh.scenes.opv2v import variants
from mast_zenoh.scenes.opv2v.agents import Poses, agent_path
from mast_zenoh.scenes.opv2v.labels import Labels, read_labels, read_pose
from mast_zenoh.scenes.opv2v.layout import AgentFolder, check_frames, choose_frames, find_scenario
from mast_zenoh.scenes.opv2v.numeric_yaml import read_yaml
from mast_zenoh.scenes.opv2v.traffic import Listed, check_ids_last, shared_ids
from mast_zenoh.scenes.opv2v.variants import Variant
from mast_zenoh.scenes.opv2v.vehicles import OwnCar, check_numbers, claim, missing_boxes
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.scenes.selection import check_counts
from mast_zenoh.sensing import DetectionModel, Detector

_DETECTOR = DetectionModel()


class ScenarioFolder(Scene):
    """What the scenes of the family have in common: parameters, the choice of agents and frames."""

    variant: Variant

    def __init__(
        self,
        *,
        path: str,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        ego: int | None = None,
        first_frame: int | None = None,
        last_frame: int | None = None,
        rate_hz: float = 10.0,
        detector: Detector = _DETECTOR,
    ) -> None:
        if isinstance(rate_hz, bool) or not isinstance(rate_hz, (int, float)) or not 0.01 <= rate_hz <= 1000:
            raise ConfigurationError(f"{path}: rate_hz is {rate_hz!r}, expected 0.01 to 1000")
        self.path = Path(path)
        self.n_infrastructure = n_infrastructure
        self.n_mobile = n_mobile
        self.ego = ego
        self.first_frame = first_frame
        self.last_frame = last_frame
        self.rate_hz = rate_hz
        self.detector = detector

    def inputs(self) -> Sequence[Path]:
        """The scenario's folder."""
        return (self.path,)

    @abstractmethod
    def record(self, seed: int, frames: int | None) -> Recording: ...

    def _times(self, frames: Sequence[int]) -> Ints:
        """(F,) ns of the frames."""
        return np.round(np.arange(len(frames)) * 1e9 / self.rate_hz).astype(np.int64)

    def _ego_first(self, folder: Path, agents: list[AgentFolder]) -> list[AgentFolder]:
        """The ego, then the other cars, then the poles."""
        cars = [agent for agent in agents if not agent.is_pole]
        if not cars:
            raise SceneError(f"{folder}: all {len(agents)} agents are infrastructure, expected at least one car")
        if self.ego is not None and self.ego not in [car.number for car in cars]:
            known = ", ".join(str(car.number) for car in cars[:20])
            raise ConfigurationError(f"{folder}: ego is {self.ego}, expected the number of a car: {known}")
        chosen = cars[0] if self.ego is None else next(car for car in cars if car.number == self.ego)
        return [chosen, *(agent for agent in agents if agent is not chosen)]

    def _playing(self, folder: Path, agents: Sequence[AgentFolder]) -> list[int]:
        """Columns of the agents that play, the ego first, then other cars, then poles."""
        cars = [column for column, agent in enumerate(agents) if not agent.is_pole and column > 0]
        poles = [column for column, agent in enumerate(agents) if agent.is_pole]
        kinds = "cars besides the ego", "poles"
        check_counts(folder, (self.n_mobile, len(cars)), (self.n_infrastructure, len(poles)), kinds)
        return [0, *cars[: self.n_mobile], *poles[: self.n_infrastructure]]


class OPV2VScene(ScenarioFolder):
    """A scenario of OPV2V or V2XSet, simulated in CARLA. See docs/scenes_opv2v.md.

    path:             the folder of a scenario, or a folder with a single one
    n_infrastructure: poles to use, the first ones; None: all
    n_mobile:         cars besides the ego to use, the first ones; None: all
    ego:              number of the car that is the ego; None: the lowest
    first_frame, last_frame: numbers of the frames to begin and to end with; None: all
    rate_hz:          frames per second; the files do not state it
    detector:         the model that generates detections from lidar visibility

    The world is CARLA's, with y inverted. An object that an agent lists was hit by its lidar: it gets the returns that
    ray casting gives, at least 5. All objects are cars.
    """

    variant = variants.OPV2V

    def record(self, seed: int, frames: int | None) -> Recording:
        folder, agents = find_scenario(self.path)
        agents = self._ego_first(folder, agents)
        numbers = choose_frames(agents[0], self.first_frame, self.last_frame)
        check_frames(agents, numbers)
        playing = self._playing(folder, agents)
        poses, labels = _read(agents, numbers, self._variant())
        boxes, seen, cars = self._traffic(agents, numbers, poses, Listed.of(labels))
        times = self._times(numbers)
        check_ids_last(boxes, times, lambda frame: agents[0].file(numbers[frame]))
        paths = []
        for column in playing:
            path = agent_path(agents, column, playing, poses, cars, self._variant(), numbers)
            paths.append(replace(path, points=listed_returns(boxes, path, seen[:, column], frames=frames)))
        return assemble(folder.name, times, boxes, paths, self.detector, seed=seed, frames=frames)

    def _variant(self) -> Variant:
        return self.variant

    def _traffic(
        self, agents: Sequence[AgentFolder], numbers: Sequence[int], poses: Poses, listed: Listed
    ) -> tuple[Boxes, Bools, dict[int, OwnCar]]:
        """All boxes, whether each agent lists them, and the agents' own cars by column."""
        variant = self._variant()

        def file_of(frame: int, column: int) -> Path:
            return agents[column].file(numbers[frame])

        columns = [column for column, agent in enumerate(agents) if not agent.is_pole]
        own = [OwnCar(agents[k].number, poses.position[:, k], poses.rotation[:, k], agents[k].number) for k in columns]
        if variant.associated:
            listed = listed.with_id(shared_ids(listed))
        if variant.body is not None:
            check_numbers(listed, own, file_of)
        else:
            listed, own = claim(listed, own)
        boxes, by_agent = listed.merged(variant.disagreement_m, file_of)
        added = [missing_boxes(boxes, car, variant) for car in own]
        seen = np.zeros((len(boxes) + sum(map(len, added)), len(agents)), np.bool_)
        seen[: len(by_agent), : by_agent.shape[1]] = by_agent
        return Boxes.concatenate([boxes, *added]), seen, dict(zip(columns, own, strict=True))


class V2XRealScene(OPV2VScene):
    """A scenario of V2X-Real, recorded by real cars and poles. See docs/scenes_opv2v.md.

    left_handed: whether y is to the right in the files. That is not stated for this data set. If it is wrong, the scene
                 is mirrored, and all results are the same.

    The other parameters are those of `OPV2VScene`. An agent is where its lidar is. The boxes of an agent's own car are
    found by their place.
    """

    variant = variants.V2X_REAL

    def __init__(
        self,
        *,
        path: str,
        n_infrastructure: int | None = None,
        n_mobile: int | None = None,
        ego: int | None = None,
        first_frame: int | None = None,
        last_frame: int | None = None,
        rate_hz: float = 10.0,
        detector: Detector = _DETECTOR,
        left_handed: bool = True,
    ) -> None:
        super().__init__(
            path=path,
            n_infrastructure=n_infrastructure,
            n_mobile=n_mobile,
            ego=ego,
            first_frame=first_frame,
            last_frame=last_frame,
            rate_hz=rate_hz,
            detector=detector,
        )
        self.left_handed = left_handed

    def _variant(self) -> Variant:
        return replace(self.variant, left_handed=self.left_handed)


class V2V4RealScene(OPV2VScene):
    """A sequence of V2V4Real, recorded by two real cars. See docs/scenes_opv2v.md.

    The parameters are those of `OPV2VScene`. Places of objects are in the frame of the lidar of the agent that lists
    them. Objects of the two agents are the same if their `ass_id` is. An agent is where its lidar is.
    """

    variant = variants.V2V4REAL


def _read(agents: Sequence[AgentFolder], numbers: Sequence[int], variant: Variant) -> tuple[Poses, list[list[Labels]]]:
    """The poses of the agents, and what each lists, for each frame."""
    labels: list[list[Labels]] = []
    poses = []
    for number in numbers:
        contents = [read_yaml(agent.file(number)) for agent in agents]
        now = [read_pose(each, variant, agent.is_pole) for each, agent in zip(contents, agents, strict=True)]
        labels.append([read_labels(each, variant, pose) for each, pose in zip(contents, now, strict=True)])
        poses.append(now)
    return Poses.of(poses), labels
