"""Scenes of Multi-V2X."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Ints
from mast_zenoh.scenes.making.assembly import assemble
from mast_zenoh.scenes.making.boxes import Boxes
from mast_zenoh.scenes.opv2v import variants
from mast_zenoh.scenes.opv2v.agents import Poses, agent_path
from mast_zenoh.scenes.opv2v.labels import AgentPose, read_labels, read_pose, read_visible
from mast_zenoh.scenes.opv2v.layout import (
    AgentFolder,
    check_frames,
    choose_frames,
    find_scenario,
    map_file,
    map_files,
)
from mast_zenoh.scenes.opv2v.numeric_yaml import read_yaml
from mast_zenoh.scenes.opv2v.scenes import ScenarioFolder
from mast_zenoh.scenes.opv2v.traffic import Listed, check_ids_last
from mast_zenoh.scenes.opv2v.vehicles import OwnCar, check_numbers, missing_boxes
from mast_zenoh.scenes.recording import Recording


class MultiV2XScene(ScenarioFolder):
    """A town of Multi-V2X, simulated in CARLA and SUMO. See docs/scenes_opv2v.md.

    path:             the folder of a town, with cav_<number>, rsu_<number> and map, or a folder with a single one
    n_infrastructure: poles to use, the ones nearest to the ego in the first frame; None: all
    n_mobile:         cars besides the ego to use, the nearest ones; None: all
    ego:              number of the car that is the ego; None: the lowest
    first_frame, last_frame: numbers of the frames to begin and to end with; None: all frames of the ego
    rate_hz:          frames per second; the files do not state it
    detector:         the model that generates detections from lidar visibility

    The world is CARLA's, with y inverted. The objects are those of the map. An agent has the lidar returns that its
    view files count; without any, ray casting decides. Agents that are not there in all of the frames are no agents.
    """

    variant = variants.MULTI_V2X

    def record(self, seed: int, frames: int | None) -> Recording:
        folder, agents = find_scenario(self.path)
        agents = self._ego_first(folder, agents)
        numbers = choose_frames(agents[0], self.first_frame, self.last_frame)
        agents = self._nearest_first([agent for agent in agents if agent.covers(numbers)], numbers[0])
        playing = self._playing(folder, agents)
        agents, playing = [agents[column] for column in playing], list(range(len(playing)))
        check_frames(agents, numbers)
        poses = Poses.of([[self._pose(agent, number) for agent in agents] for number in numbers])
        cars = {
            column: OwnCar(agent.number, poses.position[:, column], poses.rotation[:, column], agent.number)
            for column, agent in enumerate(agents)
            if not agent.is_pole
        }
        boxes = self._boxes(folder, numbers, list(cars.values()))
        times = self._times(numbers)
        check_ids_last(boxes, times, lambda frame: agents[0].file(numbers[frame]))
        paths = []
        for column in playing:
            path = agent_path(agents, column, playing, poses, cars, self.variant, numbers)
            points = _view_points(agents[column], numbers, boxes, path.agent.object_id)
            paths.append(replace(path, points=points))
        return assemble(folder.name, times, boxes, paths, self.detector, seed=seed, frames=frames)

    def _pose(self, agent: AgentFolder, number: int) -> AgentPose:
        return read_pose(read_yaml(agent.file(number)), self.variant, agent.is_pole)

    def _nearest_first(self, agents: Sequence[AgentFolder], number: int) -> list[AgentFolder]:
        """The agents by their distance from the first one in a frame."""
        place = [self._pose(agent, number).position for agent in agents]
        distance = [float(np.linalg.norm(each - place[0])) for each in place]
        return [agents[0], *(agents[k] for k in sorted(range(1, len(agents)), key=lambda k: distance[k]))]

    def _boxes(self, folder: Path, numbers: Sequence[int], cars: Sequence[OwnCar]) -> Boxes:
        """All objects of the map in the frames, and the agents' own cars where it lacks them."""
        files = map_files(folder)

        def file_of(frame: int, _: int) -> Path:
            return map_file(folder, files, numbers[frame])

        contents = [read_yaml(file_of(frame, 0)) for frame in range(len(numbers))]
        listed = Listed.of([[read_labels(content, self.variant, None)] for content in contents])
        check_numbers(listed, cars, file_of)
        boxes, _ = listed.merged(self.variant.disagreement_m, file_of)
        return Boxes.concatenate([boxes, *(missing_boxes(boxes, car, self.variant) for car in cars)])


def _view_points(agent: AgentFolder, numbers: Sequence[int], boxes: Boxes, object_id: int) -> NDArray[np.int32] | None:
    """(N,) lidar returns of each box, as the agent's view files count them; None without any file."""
    if not agent.views:
        return None
    points = np.zeros(len(boxes), np.int32)
    for frame, number in enumerate(numbers):
        rows = np.flatnonzero(boxes.frame == frame)
        ids: Ints = boxes.id[rows]
        visible = read_visible(read_yaml(agent.view(number)), ids)
        points[rows] = [0 if each == object_id else visible.get(each, 0) for each in ids.tolist()]
    return points
