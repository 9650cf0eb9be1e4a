"""Scenes of OPV2V and its relatives: V2XSet, V2X-Real, V2V4Real and Multi-V2X."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_datasets import opv2v_files as layout
from mast_datasets.files import read_yaml
from mast_datasets.opv2v_files import AgentFolder, Poses, Variant
from mast_datasets.point_files import PointFiles, read_pcd
from mast_datasets.traffic import DataSetScene, check_steps, choose_frames, listed_returns
from mast_zenoh.arrays.geometry import heading, rotation_from_yaw
from mast_zenoh.arrays.states import CLASS_INDEX, Bools, Floats, Ints
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.making.assembly import AgentPath, SceneBoxes, assemble
from mast_zenoh.scenes.recording import Recording, SceneAgent
from mast_zenoh.sensing import Camera, Points

_MAX_SPEED_M_S = 70.0  # of an object whose id lasts,
_MAX_STEP_M = 5.0  # in addition to this


@dataclass(frozen=True, eq=False)
class Listed:
    """N boxes, as the agents list them.

    agent: (N,) column of the agent;  associated: (N,) id that agents share, -1 if there is none
    files: of each agent, for each frame
    """

    agent: Ints
    associated: Ints
    boxes: SceneBoxes
    files: Sequence[Sequence[Path]]

    @classmethod
    def of(cls, labels: Sequence[tuple[SceneBoxes, Ints]], files: Sequence[Sequence[Path]]) -> Listed:
        """The objects in the files of each agent, frame by frame."""
        boxes, associated = zip(*labels, strict=True)
        agent = np.repeat(np.arange(len(boxes)) % len(files[0]), [*map(len, boxes)])
        return cls(agent, np.concatenate(associated), SceneBoxes.concatenate(boxes), files)

    def file(self, row: int) -> Path:
        """The file that lists the object in a row."""
        return self.files[int(self.boxes.frame[row])][int(self.agent[row])]

    def with_id(self, number: Ints) -> Listed:
        """The same objects with other ids (N,)."""
        return replace(self, boxes=replace(self.boxes, id=number))

    def merged(self, limit_m: float) -> tuple[SceneBoxes, Bools]:
        """One box for each object and frame, by frame and id, and whether each agent (column) lists it.

        limit_m: how far apart the agents may place an object; that of the first agent counts

        Raises SceneError if they are further apart, and for an object that an agent lists twice.
        """
        frame, number, position = self.boxes.frame, self.boxes.id, self.boxes.position
        order = np.lexsort((self.agent, number, frame))
        first = _begins(frame[order], number[order])
        group = np.cumsum(first) - 1
        repeated = ~first[1:] & (np.diff(self.agent[order]) == 0)
        for row in order[1:][repeated]:
            raise SceneError(f"{self.file(row)}: found object {number[row]} twice, expected it once")
        chosen = order[first]
        apart = np.linalg.norm(position[order] - position[chosen][group], axis=1)
        if (apart > limit_m).any():
            worst = int(apart.argmax())
            row, other = order[worst], self.file(int(chosen[group[worst]])).parent.name
            raise SceneError(
                f"{self.file(row)}: object {number[row]} is {apart[worst]:.2f} m from where agent {other} lists it, "
                f"expected at most {limit_m:g} m"
            )
        seen = np.zeros((len(chosen), int(self.agent.max(initial=-1)) + 1), np.bool_)
        seen[group, self.agent[order]] = True
        return self.boxes.select(chosen), seen


def _begins(*columns: Ints) -> Bools:
    """(n,) where a row of columns (n,) differs from the one before."""
    return np.append(True, np.any([np.diff(column) != 0 for column in columns], axis=0))[: len(columns[0])]


def check_ids_last(boxes: SceneBoxes, times_ns: Ints, files: Sequence[Path]) -> None:
    """Raise SceneError for an id that is somewhere else a moment later: then it is another object.

    files: one of each frame, for the message
    """
    order = np.lexsort((boxes.frame, boxes.id))
    same = np.diff(boxes.id[order]) == 0
    step = np.linalg.norm(np.diff(boxes.position[order], axis=0), axis=1)
    limit = _MAX_STEP_M + _MAX_SPEED_M_S * np.diff(times_ns[boxes.frame[order]]) / 1e9
    for jump in np.flatnonzero(same & (step > limit)):
        before, after = (files[boxes.frame[row]] for row in order[jump : jump + 2])
        raise SceneError(
            f"{after}: object {boxes.id[order[jump]]} is {step[jump]:.1f} m from where it was in {before.name}, "
            f"expected at most {limit[jump]:.1f} m: an id must be that of one object"
        )


def shared_ids(listed: Listed) -> Ints:
    """(N,) ids that all agents share, of objects that have an id for each agent, and possibly an associated one.

    An associated id is kept. An object that has a single one in some frames keeps it in the others, too. All others
    get the next ids that are free, one for each object of each agent.
    """
    pair = np.stack([listed.agent, listed.boxes.id], axis=1)
    own = np.unique(pair, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    shared = listed.associated.copy()
    pairs = np.unique(np.stack([own, shared], axis=1)[shared >= 0], axis=0)
    objects, index, count = np.unique(pairs[:, 0], return_index=True, return_counts=True)
    known = dict(zip(objects[count == 1].tolist(), pairs[index[count == 1], 1].tolist(), strict=True))
    taken = set(zip(listed.boxes.frame.tolist(), listed.agent.tolist(), shared.tolist(), strict=True))
    for row in np.flatnonzero(shared < 0).tolist():
        candidate = known.get(int(own[row]), -1)
        place = (int(listed.boxes.frame[row]), int(listed.agent[row]), candidate)
        if candidate >= 0 and place not in taken:
            shared[row] = candidate
            taken.add(place)
    return np.where(shared >= 0, shared, own + 1 + shared.max(initial=-1))


_MAX_DISTANCE_M = 2.0  # on the ground, of the middle of an agent's own box
_MIN_LENGTH_M = 2.5  # of a car
_CARS = [CLASS_INDEX[name] for name in ("unknown", "car", "truck", "bus")]


class OwnCar(NamedTuple):
    """A car that is an agent.

    number: of the agent;  position (F, 3) m and rotation (F, 3, 3) of the agent;  object_id: of its boxes
    """

    number: int
    position: Floats
    rotation: Floats
    object_id: int


def own_cars(agents: Sequence[AgentFolder], poses: Poses) -> dict[int, OwnCar]:
    """The cars among the agents, by column, with their numbers as ids."""
    return {
        column: OwnCar(agent.number, poses.position[:, column], poses.rotation[:, column], agent.number)
        for column, agent in enumerate(agents)
        if not agent.is_pole
    }


def check_numbers(listed: Listed, cars: Sequence[OwnCar]) -> None:
    """Raise SceneError for a box with an agent's number that is not where the agent is."""
    for car in cars:
        distance = _distance(listed, car)
        for row in np.flatnonzero((listed.boxes.id == car.number) & (distance > _MAX_DISTANCE_M)):
            place = f"{listed.file(int(row))}: object {car.number} is {distance[row]:.2f} m from agent {car.number}"
            raise SceneError(f"{place}, expected at most {_MAX_DISTANCE_M:g} m: it is the same car")


def claim(listed: Listed, cars: Sequence[OwnCar]) -> tuple[Listed, list[OwnCar]]:
    """Find each agent's own boxes by their places, for data sets whose ids are not the agents' numbers.

    A box of a car within 2 m of an agent is the agent's, of each file the nearest one. It keeps its id if all boxes
    with that id are the agent's; otherwise the agent's boxes get an id that no other object has.
    """
    ids = listed.boxes.id.copy()
    claimed: list[OwnCar] = []
    for car in cars:
        rows = _nearest(listed, _distance(listed, car))
        mine, count = np.unique(ids[rows], return_counts=True)
        complete = np.array([number for number in mine if (ids == number).sum() == count[mine == number][0]], np.int64)
        taken = {other.object_id for other in claimed}
        is_free = car.number not in taken and car.number not in ids
        chosen = car.number if is_free else max(int(ids.max(initial=0)), *taken, 0) + 1
        if len(complete):
            chosen = int(complete[np.argmax(count[np.isin(mine, complete)])])
        ids[rows] = chosen
        claimed.append(OwnCar(car.number, car.position, car.rotation, chosen))
    return listed.with_id(ids), claimed


def missing_boxes(boxes: SceneBoxes, car: OwnCar, variant: Variant) -> SceneBoxes:
    """Boxes of an agent's car in the frames in which nobody lists it.

    Their size and their place on the agent are those of the listed boxes; without any, the data set's usual car.
    """
    own = np.flatnonzero(boxes.id == car.object_id)
    frames = np.setdiff1d(np.arange(len(car.position)), boxes.frame[own])
    size, centre, class_id = variant.own_size, variant.own_centre, CLASS_INDEX["car"]
    if len(own):
        rotation = _upright(car.rotation[boxes.frame[own]])
        offset = boxes.position[own] - car.position[boxes.frame[own]]
        centre = np.einsum("nji,nj->ni", rotation, offset).mean(axis=0)
        size, class_id = np.median(boxes.size[own], axis=0), int(np.bincount(boxes.class_id[own]).argmax())
    position, yaw = car.position[frames] + _upright(car.rotation[frames]) @ centre, heading(car.rotation[frames])
    return replace(SceneBoxes.throughout(car.object_id, position, size, yaw, class_id), frame=frames.astype(np.int64))


def _upright(rotation: Floats) -> Floats:
    """(n, 3, 3) rotations with the same heading as those of lidars, which may be tilted on their cars."""
    return np.array([rotation_from_yaw(float(yaw)) for yaw in heading(rotation)]).reshape(-1, 3, 3)


def _distance(listed: Listed, car: OwnCar) -> Floats:
    """(N,) m on the ground from the agent to each box."""
    return np.asarray(np.hypot(*(listed.boxes.position[:, :2] - car.position[listed.boxes.frame, :2]).T))


def _nearest(listed: Listed, distance: Floats) -> Ints:
    """Rows of the nearest car in each file, if it is near enough."""
    near: Bools = (distance <= _MAX_DISTANCE_M) & (listed.boxes.size[:, 0] >= _MIN_LENGTH_M)
    rows = np.flatnonzero(near & np.isin(listed.boxes.class_id, _CARS))
    rows = rows[np.lexsort((distance[rows], listed.agent[rows], listed.boxes.frame[rows]))]
    return rows[_begins(listed.boxes.frame[rows], listed.agent[rows])]


_MAX_MOUNT_ERROR_M = 0.5  # between a lidar's place on its car in two frames
_MAX_POLE_STEP_M = 1.0  # of a pole, which does not move
_CAMERA_BELOW_LIDAR_M = 0.2


class Playing(NamedTuple):
    """What is played of a scenario.

    agents: of the scenario;  columns: of those that play, the ego first, then other cars, then poles
    numbers: of the frames;  poses: of the agents;  boxes: of all objects;  cars: of agents, by column
    seen: whether each agent (column) lists each box (row)
    """

    agents: Sequence[AgentFolder]
    columns: Sequence[int]
    numbers: Sequence[int]
    poses: Poses
    boxes: SceneBoxes
    cars: Mapping[int, OwnCar]
    seen: Bools

    def path(self, column: int, variant: Variant) -> AgentPath:
        """The path of an agent and its sensors, without what it sees.

        Raises SceneError for a pole that moves and for a lidar that moves on its car.
        """
        agent, position, rotation = self.agents[column], self.poses.position[:, column], self.poses.rotation[:, column]
        order = [k for k in self.columns if self.agents[k].is_pole == agent.is_pole].index(column)
        if agent.is_pole:
            step = np.linalg.norm(position - position[0], axis=1).max()
            if step > _MAX_POLE_STEP_M:
                expected = f"expected at most {_MAX_POLE_STEP_M:g} m"
                raise SceneError(f"{agent.folder}: the pole moves {step:.2f} m, {expected}")
            camera = Camera(mount_position=np.zeros(3))
            return AgentPath(SceneAgent(f"infra_{order + 1}", "static", -1, variant.pole, camera), position, rotation)
        mounts = np.einsum("fji,fj->fi", rotation, self.poses.lidar[:, column] - position)
        mount = np.median(mounts, axis=0)
        apart = np.linalg.norm(mounts - mount, axis=1)
        if apart.max() > _MAX_MOUNT_ERROR_M:
            raise SceneError(
                f"{agent.file(self.numbers[int(apart.argmax())])}: lidar_pose is {apart.max():.2f} m from where the "
                f"lidar is on the car in other frames, expected at most {_MAX_MOUNT_ERROR_M:g} m"
            )
        camera = Camera(mount_position=mount - [0.0, 0.0, _CAMERA_BELOW_LIDAR_M])
        name, sensor = f"mobile_{order}" if order else "ego", replace(variant.car, mount_position=mount)
        described = SceneAgent(name, "mobile", self.cars[column].object_id, sensor, camera)
        return AgentPath(described, position, rotation)


@dataclass(kw_only=True, eq=False)
class ScenarioFolder(PointFiles, DataSetScene):
    """What the scenes of the family have in common: parameters, the choice of agents and frames.

    ego:                     number of the car that is the ego; None: the lowest
    first_frame, last_frame: numbers of the frames to begin and to end with; None: all
    rate_hz:                 frames per second; the files do not state it
    """

    variant: ClassVar[Variant]

    ego: int | None = None
    first_frame: int | None = None
    last_frame: int | None = None
    rate_hz: float = 10.0

    def __post_init__(self) -> None:
        self.check(rate_hz=(0.01, 1000.0))

    def _variant(self) -> Variant:
        return self.variant

    @abstractmethod
    def _read(self, folder: Path, agents: list[AgentFolder], numbers: Sequence[int]) -> Playing:
        """What is played. agents: the ego first; numbers: of the frames"""

    @abstractmethod
    def _points(self, playing: Playing, column: int, path: AgentPath, frames: int | None) -> NDArray[np.int32] | None:
        """(N,) lidar returns of each box at an agent; None: by ray casting. frames: how many are wanted"""

    def record(self, seed: int, frames: int | None) -> Recording:
        folder, agents = layout.find_scenario(self.root)
        agents = self._ego_first(folder, agents)
        ego, known = agents[0], list(agents[0].files)
        numbers = [known[row] for row in choose_frames(ego.folder, known, self.first_frame, self.last_frame)]
        check_steps(ego.folder, numbers, "; first_frame and last_frame choose a part without a gap")
        playing = self._read(folder, agents, numbers)
        times = np.round(np.arange(len(numbers)) * 1e9 / self.rate_hz).astype(np.int64)
        check_ids_last(playing.boxes, times, [ego.file(number) for number in numbers])
        paths = []
        for column in playing.columns:
            path = playing.path(column, self._variant())
            paths.append(replace(path, points=self._points(playing, column, path, frames)))
        recording = assemble(folder.name, times, playing.boxes, paths, self.detector, seed=seed, frames=frames)
        playing_agents = [playing.agents[column] for column in playing.columns]
        files = [[agent.file(number).with_suffix(".pcd") for number in numbers] for agent in playing_agents]
        return self.with_points(recording, folder, *files, read=self._scan)

    def _scan(self, path: Path) -> Points:
        """The points of a file, with y to the left."""
        points = read_pcd(path)
        return points.turned(np.diag(layout.FLIP)) if self._variant().left_handed else points

    def _ego_first(self, folder: Path, agents: list[AgentFolder]) -> list[AgentFolder]:
        """The ego, then the other cars, then the poles."""
        cars = {agent.number: agent for agent in agents if not agent.is_pole}
        if not cars:
            raise SceneError(f"{folder}: all {len(agents)} agents are infrastructure, expected at least one car")
        if self.ego is not None and self.ego not in cars:
            known = ", ".join(map(str, list(cars)[:20]))
            raise ConfigurationError(f"{folder}: ego is {self.ego}, expected the number of a car: {known}")
        chosen = cars[next(iter(cars)) if self.ego is None else self.ego]
        return [chosen, *(agent for agent in agents if agent is not chosen)]

    def _playing(self, agents: Sequence[AgentFolder]) -> list[int]:
        """Columns of the agents that play, the ego first, then other cars, then poles."""
        columns = range(len(agents))
        cars = [column for column in columns if not agents[column].is_pole]
        cars, poles = self.playing(cars, [column for column in columns if agents[column].is_pole])
        return [*cars, *poles]


class OPV2VScene(ScenarioFolder):
    """A scenario of OPV2V or V2XSet, simulated in CARLA. See docs/how-to-data-sets.md.

    path: the folder of a scenario, or a folder with a single one

    The world is CARLA's, with y inverted. An object that an agent lists was hit by its lidar: it gets the returns that
    ray casting gives, at least 5. All objects are cars.
    """

    short_name = "opv2v"
    files: ClassVar[tuple[tuple[str, ...], ...]] = (("data_protocol.yaml", "*/*.yaml", "!map/*.yaml"),)

    variant = layout.OPV2V

    def _read(self, folder: Path, agents: list[AgentFolder], numbers: Sequence[int]) -> Playing:
        files, variant = layout.files_of_frames(agents, numbers), self._variant()
        labels, rows = [], list[list[Poses]]()
        for frame, of_agents in enumerate(files):
            rows.append([])
            for file, agent in zip(of_agents, agents, strict=True):
                content = read_yaml(file)
                rows[-1].append(pose := layout.read_pose(content, variant, agent.is_pole))
                labels.append(layout.read_labels(content, variant, pose, frame))
        poses, listed = layout.joined_poses(rows), Listed.of(labels, files)
        cars = own_cars(agents, poses)
        own = list(cars.values())
        if variant.own_labels:
            listed = listed.with_id(shared_ids(listed))
        if variant.body is not None:
            check_numbers(listed, own)
        else:
            listed, own = claim(listed, own)
        boxes, by_agent = listed.merged(variant.disagreement_m)
        boxes = SceneBoxes.concatenate([boxes, *(missing_boxes(boxes, car, variant) for car in own)])
        seen = np.zeros((len(boxes), len(agents)), np.bool_)
        seen[: len(by_agent), : by_agent.shape[1]] = by_agent
        return Playing(agents, self._playing(agents), numbers, poses, boxes, dict(zip(cars, own, strict=True)), seen)

    def _points(self, playing: Playing, column: int, path: AgentPath, frames: int | None) -> NDArray[np.int32]:
        return listed_returns(playing.boxes, path, playing.seen[:, column], frames=frames)


@dataclass(kw_only=True, eq=False)
class V2XRealScene(OPV2VScene):
    """A scenario of V2X-Real, recorded by real cars and poles. See docs/how-to-data-sets.md.

    left_handed: whether y is to the right in the files. That is not stated for this data set. If it is wrong, the scene
                 is mirrored, and all results are the same.

    The other parameters are those of `OPV2VScene`. An agent is where its lidar is. The boxes of an agent's own car are
    found by their place.
    """

    short_name = "v2xreal"
    files = (("-[0-9]*/*.yaml", "!data_protocol.yaml"),)

    variant = layout.V2X_REAL

    left_handed: bool = True

    def _variant(self) -> Variant:
        return replace(self.variant, left_handed=self.left_handed)


class V2V4RealScene(OPV2VScene):
    """A sequence of V2V4Real, recorded by two real cars. See docs/how-to-data-sets.md.

    The parameters are those of `OPV2VScene`. Places of objects are in the frame of the lidar of the agent that lists
    them. Objects of the two agents are the same if their `ass_id` is. An agent is where its lidar is.
    """

    short_name = "v2v4real"
    files = (("0/*.yaml", "1/*.yaml", "!data_protocol.yaml", "!-[0-9]*/*.yaml"),)

    variant = layout.V2V4REAL


class MultiV2XScene(ScenarioFolder):
    """A town of Multi-V2X, simulated in CARLA and SUMO. See docs/how-to-data-sets.md.

    path:             the folder of a town, with `cav_<number>`, `rsu_<number>` and map, or a folder with one of these
    n_infrastructure: poles to use, the ones nearest to the ego in the first frame; None: all
    n_mobile:         cars besides the ego to use, the nearest ones; None: all

    The world is CARLA's, with y inverted. The objects are those of the map. An agent has the lidar returns that its
    view files count; without any, ray casting decides. Agents that are not there in all of the frames are no agents.
    """

    short_name = "multiv2x"
    files = (("map/*.yaml",),)

    variant = layout.MULTI_V2X

    def _read(self, folder: Path, agents: list[AgentFolder], numbers: Sequence[int]) -> Playing:
        agents = self._nearest_first([agent for agent in agents if agent.covers(numbers)], numbers[0])
        agents = [agents[column] for column in self._playing(agents)]
        layout.files_of_frames(agents, numbers)
        poses = layout.joined_poses([[self._pose(agent, number) for agent in agents] for number in numbers])
        cars = own_cars(agents, poses)
        of_map = layout.map_files(folder)
        files = [[layout.file_of_frame(folder / "map", of_map, number)] for number in numbers]
        labels = [layout.read_labels(read_yaml(file), self.variant, None, k) for k, (file,) in enumerate(files)]
        listed = Listed.of(labels, files)
        check_numbers(listed, list(cars.values()))
        boxes, seen = listed.merged(self.variant.disagreement_m)
        boxes = SceneBoxes.concatenate([boxes, *(missing_boxes(boxes, car, self.variant) for car in cars.values())])
        return Playing(agents, range(len(agents)), numbers, poses, boxes, cars, seen)

    def _pose(self, agent: AgentFolder, number: int) -> Poses:
        return layout.read_pose(read_yaml(agent.file(number)), self.variant, agent.is_pole)

    def _nearest_first(self, agents: Sequence[AgentFolder], number: int) -> list[AgentFolder]:
        """The agents by their distance from the first one in a frame."""
        place = [self._pose(agent, number).position for agent in agents]
        distance = [float(np.linalg.norm(each - place[0])) for each in place]
        return [agents[0], *(agents[k] for k in sorted(range(1, len(agents)), key=lambda k: distance[k]))]

    def _points(self, playing: Playing, column: int, path: AgentPath, frames: int | None) -> NDArray[np.int32] | None:
        agent, boxes = playing.agents[column], playing.boxes
        if not agent.views:
            return None
        points = np.zeros(len(boxes), np.int32)
        for frame, number in enumerate(playing.numbers):
            rows = np.flatnonzero(boxes.frame == frame)
            ids: Ints = boxes.id[rows]
            file = layout.file_of_frame(agent.folder, agent.views, number, "_view")
            visible = layout.read_visible(read_yaml(file), ids)
            points[rows] = [0 if each == path.agent.object_id else visible.get(each, 0) for each in ids.tolist()]
        return points
