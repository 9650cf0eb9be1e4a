"""Files of OPV2V and its relatives: folders of agents, poses and labelled objects."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from mast_datasets.files import Coordinate, Count, Element, Point, Size, Whole, entries, find_folder
from mast_datasets.traffic import classes_of
from mast_zenoh.arrays.geometry import heading
from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.making.assembly import SceneBoxes
from mast_zenoh.sensing import LidarSensor

_CLASS_OF_CATEGORY = classes_of(
    car="car policecar longvehicle van",
    truck="truck concretetruck pickuptruck semitruck",
    bus="bus",
    motorcycle="motorcycle motorcylerider motorcyclerider",
    bicycle="bicycle bicyclerider cycle",
    pedestrian="pedestrian child roadworker",
)
#: Categories of objects that are not road users.
LEFT_OUT = ("constructioncart", "firehydrant", "trashcan")

#: The car of all agents of OPV2V and V2XSet, a Lincoln MKZ; its size is in the annotation example of OpenCOOD.
_LINCOLN = np.array([4.902, 2.128, 1.511])


def category_key(text: str) -> str:
    """A category in lower case without spaces, hyphens and underscores."""
    return "".join(letter for letter in text.lower() if letter not in " -_")


def _lidar(low: float, high: float, range_m: float) -> LidarSensor:
    # 1.3 million beams/s of 64 channels at 20 Hz
    lidar = LidarSensor(np.zeros(3), azimuth_step_deg=0.36, max_range_m=range_m)
    return replace(lidar, elevation_min_deg=low, elevation_max_deg=high)


@dataclass(frozen=True, eq=False)
class Variant:
    """Conventions of a data set.

    left_handed:    y is to the right, as in CARLA; it is inverted, and with it yaw and roll
    objects:        key of the objects in an agent's file
    category:       key of an object's category; None: all are cars
    own_labels:     of each agent: places are in the frame of its lidar, and `ass_id` is the id that agents share
    body:           key of the pose of a car's body on the ground; None: the car is where its lidar is
    car, pole:      lidars of the agents, without their mount
    disagreement_m: how far apart the places of one object may be in the files of two agents
    own_size:       (3,) m of a car that no other agent ever lists, and
    own_centre:     (3,) m the middle of its box in the frame of the agent
    """

    left_handed: bool
    objects: str = "vehicles"
    category: str | None = None
    own_labels: bool = False
    body: str | None = None
    car: LidarSensor = field(default_factory=lambda: _lidar(-25.0, 2.0, 120.0))
    pole: LidarSensor = field(default_factory=lambda: _lidar(-40.0, 0.0, 120.0))
    disagreement_m: float = 5.0
    own_size: Floats = field(default_factory=_LINCOLN.copy)
    own_centre: Floats = field(default_factory=lambda: np.array([0.0, 0.0, _LINCOLN[2] / 2]))


#: The middle of a car's box in the frame of a lidar that is 1.9 m above the ground.
_UNDER_LIDAR = np.array([0.0, 0.0, _LINCOLN[2] / 2 - 1.9])

OPV2V = Variant(left_handed=True, body="true_ego_pos", disagreement_m=0.5)
MULTI_V2X = Variant(
    left_handed=True,
    objects="objects",
    category="category",
    body="true_ego_pos",
    car=_lidar(-30.0, 10.0, 120.0),
    disagreement_m=0.5,
)
V2X_REAL = Variant(
    left_handed=True,
    category="obj_type",
    car=_lidar(-25.0, 15.0, 200.0),
    pole=_lidar(-45.0, 15.0, 200.0),
    own_centre=_UNDER_LIDAR,
)
V2V4REAL = Variant(
    left_handed=False,
    category="obj_type",
    own_labels=True,
    car=_lidar(-25.0, 15.0, 200.0),
    own_centre=_UNDER_LIDAR,
)


_Pose = tuple[Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate]
#: Inverts y.
FLIP = np.array([1.0, -1.0, 1.0])


def pose(element: Element, left_handed: bool) -> tuple[Floats, Floats]:
    """Position (3,) m and active rotation (3, 3) of [x, y, z, roll, yaw, pitch], or of a 4 x 4 matrix.

    left_handed: whether y is to the right in the file
    """
    if isinstance(element.value, list) and len(element.value) == 4:
        position, rotation = element.rigid()
        rotation = rotation * np.outer(FLIP, FLIP) if left_handed else rotation
    else:
        values = np.array(element.read(_Pose))
        position, rotation = values[:3], rotations(values[None, 3:], left_handed)[0]
    return (position * FLIP if left_handed else position), rotation


def rotations(angle: Floats, left_handed: bool) -> Floats:
    """(n, 3, 3) active rotations of angles (n, 3), roll, yaw and pitch in degrees.

    left_handed: whether y is to the right in the file
    """
    roll, yaw, pitch = angle.T * (math.pi / 180.0)
    roll, yaw = (roll, -yaw) if left_handed else (-roll, yaw)
    cr, sr, cy, sy, cp, sp = (turn(each) for each in (roll, yaw, pitch) for turn in (np.cos, np.sin))
    # Rz(yaw) Ry(-pitch) Rx(roll)
    rows = [
        [cy * cp, -cy * sp * sr - sy * cr, -cy * sp * cr + sy * sr],
        [sy * cp, -sy * sp * sr + cy * cr, -sy * sp * cr - cy * sr],
        [sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


_AGENT = re.compile(r"(?:(cav|rsu)_)?(-?[0-9]{1,9})")
_FRAME = re.compile(r"([0-9]{1,9})\.yaml")
_VIEW = re.compile(r"([0-9]{1,9})_view\.yaml")


class AgentFolder(NamedTuple):
    """The folder of an agent.

    number: of the agent; is_pole: whether it is infrastructure
    files: the file of each frame, ascending; views: those of what it sees, {} without any
    """

    folder: Path
    number: int
    is_pole: bool
    files: dict[int, Path]
    views: dict[int, Path]

    def file(self, frame: int) -> Path:
        """The file of a frame. Raises SceneError if there is none."""
        return file_of_frame(self.folder, self.files, frame)

    def covers(self, frames: Sequence[int]) -> bool:
        """Whether the agent is there from the first to the last of the frames."""
        return bool(self.files) and min(self.files) <= frames[0] and frames[-1] <= max(self.files)


def find_scenario(path: Path) -> tuple[Path, list[AgentFolder]]:
    """The folder of the scenario at `path`, and its agents by number, cars first.

    path: the scenario's folder, or a folder that holds a single one
    """
    what = "scenarios, folders of agents' folders with files <frame>.yaml"
    # The agents of the scenario itself have files, no agents.
    folder = find_folder(path, what, lambda folder: any(map(_is_agent, entries(folder))))
    agents = [_agent(child) for child in entries(folder) if _is_agent(child)]
    agents.sort(key=lambda agent: (agent.is_pole, abs(agent.number)))
    for one, other in itertools.pairwise(sorted(agents, key=lambda agent: (agent.is_pole, agent.number))):
        if one.number == other.number:
            raise SceneError(f"{other.folder}: found agent {other.number} twice, also {one.folder.name}")
    return folder, agents


def map_files(folder: Path) -> dict[int, Path]:
    """The files of all objects of a scenario (Multi-V2X), by frame."""
    files = _frames(folder / "map", _FRAME) if (folder / "map").is_dir() else {}
    if not files:
        raise SceneError(f"{folder / 'map'}: no files <frame>.yaml, expected one with all objects of each frame")
    return files


def files_of_frames(agents: Sequence[AgentFolder], frames: Sequence[int]) -> list[list[Path]]:
    """The file of each agent, for each frame. Raises SceneError for an agent that has other frames than the ego."""
    for agent in agents:
        extra = [frame for frame in agent.files if frames[0] <= frame <= frames[-1] and frame not in frames]
        if extra:
            raise SceneError(f"{agent.files[extra[0]]}: the ego has no frame {extra[0]}, expected the same frames")
    return [[agent.file(frame) for agent in agents] for frame in frames]


def _is_agent(folder: Path) -> bool:
    is_named = _AGENT.fullmatch(folder.name) and folder.is_dir()
    return bool(is_named) and any(_FRAME.fullmatch(child.name) for child in entries(folder))


def _agent(folder: Path) -> AgentFolder:
    kind, _, name = folder.name.rpartition("_")
    is_pole = kind == "rsu" or int(name) < 0
    return AgentFolder(folder, int(name), is_pole, _frames(folder, _FRAME), _frames(folder, _VIEW))


def _frames(folder: Path, pattern: re.Pattern[str]) -> dict[int, Path]:
    """Files by the number in their names, ascending."""
    files: dict[int, Path] = {}
    for path in entries(folder):
        if match := pattern.fullmatch(path.name):
            other = files.setdefault(int(match[1]), path)
            if other != path:
                raise SceneError(f"{path}: found frame {int(match[1])} twice, also {other.name}")
    return dict(sorted(files.items()))


def file_of_frame(folder: Path, files: dict[int, Path], frame: int, ending: str = "") -> Path:
    """The file of a frame. Raises SceneError if there is none."""
    if frame not in files:
        reason = "" if ending else ": agents that appear or disappear cannot be played"
        raise SceneError(f"{folder}: no file for frame {frame}, expected {frame:06d}{ending}.yaml{reason}")
    return files[frame]


class _Visible(Struct):
    object_id: Whole
    visible_points: Count
    category: str | None = None


class _Placed(Struct):
    location: Point
    center: Point
    extent: Size
    angle: Point
    ass_id: Annotated[int, Meta(ge=-1, le=10**12)] | None = None


class Poses(NamedTuple):
    """Poses of agents in the world: position (…, 3) m of the body, lidar (…, 3) m, and rotation (…, 3, 3) of the lidar.

    The axes before are none for one agent in one frame, or F frames and A agents.
    """

    position: Floats
    lidar: Floats
    rotation: Floats


def joined_poses(poses: Sequence[Sequence[Poses]]) -> Poses:
    """The poses of the agents for each frame as one."""
    return Poses(*(np.array([[each[column] for each in now] for now in poses]) for column in range(3)))


def read_pose(content: Element, variant: Variant, is_pole: bool) -> Poses:
    """The pose of an agent in a file."""
    lidar, rotation = pose(content["lidar_pose"], variant.left_handed)
    if variant.body is None or is_pole:
        return Poses(lidar, lidar, rotation)
    body, _ = pose(content[variant.body], variant.left_handed)
    return Poses(body, lidar, rotation)


def read_labels(content: Element, variant: Variant, agent: Poses | None, frame: int) -> tuple[SceneBoxes, Ints]:
    """The objects in a file in the world frame, without those that are not road users.

    agent: whose file it is; needed if places are in the frame of its lidar; frame: row of the frame of the boxes

    Also returns the id (n,) of each that agents share, -1 if there is none.
    """
    listed, rows = content[variant.objects], []
    for key, each in listed.members() if listed.value else ():  # PyYAML may write none as null or []
        number = Element(key, listed.path, each.place).read(Whole)
        category = None if variant.category is None else category_key(each[variant.category].text())
        if category not in LEFT_OUT:
            kind = CLASS_INDEX["car"] if category is None else _CLASS_OF_CATEGORY.get(category, 0)
            box: _Placed = each.read(_Placed)
            shared = box.ass_id if variant.own_labels and box.ass_id is not None else -1
            rows.append((number, shared, kind, *box.location, *box.center, *box.extent, *box.angle))
    table = np.array([row[3:] for row in rows], np.float64).reshape(-1, 12)
    ids, associated, classes = np.array([row[:3] for row in rows], np.int64).reshape(-1, 3).T
    position = (table[:, :3] + table[:, 3:6]) * (FLIP if variant.left_handed else 1.0)
    rotation = rotations(table[:, 9:], variant.left_handed)
    if variant.own_labels and agent is not None:
        position = agent.lidar + position @ agent.rotation.T
        rotation = agent.rotation @ rotation
    now, class_id = np.full(len(ids), frame, np.int64), classes.astype(np.uint8)
    return SceneBoxes(now, ids, position, 2.0 * table[:, 6:9], heading(rotation), class_id), associated


def read_visible(content: Element, known: Ints) -> dict[int, int]:
    """Lidar returns by object, from a file of what an agent sees.

    known: (n,) ids of the objects in that frame
    """
    objects, visible = set(known.tolist()), dict[int, int]()
    for element in content["visible_objects"].elements():
        each: _Visible = element.read(_Visible)
        if each.object_id in visible:
            element.fail("each object once")
        if each.category is None or category_key(each.category) not in LEFT_OUT:
            if each.object_id not in objects:
                element.fail("an object that the map has in this frame")
            visible[each.object_id] = each.visible_points
    return visible
