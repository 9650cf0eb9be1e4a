"""Objects and poses of a recording by a plain loop over mcap and msgpack, to compare exports with."""

from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import numpy as np
from mcap.reader import make_reader

CLASSES = ("unknown", "car", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
#: The names in files of the estimates on a key, by its last parts; of an intercepted wire, the tap leg comes first.
_ESTIMATES = {"tracks": "local", "mission": "mission"}


class Boxes(NamedTuple):
    """Objects of a message, sorted by id. number: (n,);  box: (n, 7) x y z l w h m, yaw rad;  other columns by name"""

    number: np.ndarray
    box: np.ndarray
    columns: dict[str, np.ndarray]


class PlainRecord:
    """The messages of a run.

    boxes:  by name of an estimate in files (truth, picture, ego.local) and frame
    topics: key expression by name of an estimate
    poses:  by agent and frame, position (3,) and quaternion w x y z (4,)
    """

    def __init__(self, folder: Path) -> None:
        self.boxes: defaultdict[str, dict[int, Boxes]] = defaultdict(dict)
        self.topics: dict[str, str] = {}
        self.poses: defaultdict[str, dict[int, tuple[np.ndarray, np.ndarray]]] = defaultdict(dict)
        self.times_ns: dict[int, int] = {}
        with (folder / "messages.mcap").open("rb") as file:
            messages = [
                (channel.topic, msgpack.unpackb(message.data))
                for _, channel, message in make_reader(file).iter_messages()
            ]
        tapped = {topic.split("/@")[0] for topic, _ in messages if "@" in topic}
        for topic, message in messages:
            columns = {name: _array(*value) for name, value in message["body"].items()}
            frame, parts = message["frame"], topic.split("/")
            self.times_ns[frame] = message["time_ns"]
            if topic.endswith("/pose"):
                self.poses[parts[1]][frame] = columns["position"], columns["rotation"]
            for name, as_topic in _names(topic, parts, tapped):
                assert not np.any(columns.get("origin", 0.0)), "the boxes are not in the world frame"
                self.topics[name] = as_topic
                self.boxes[name][frame] = _boxes(columns)

    @property
    def frames(self) -> list[int]:
        return sorted(self.boxes["truth"])

    def count(self, name: str) -> int:
        """The number of boxes of an estimate in all frames."""
        return sum(len(boxes.number) for boxes in self.boxes[name].values())


def _names(topic: str, parts: list[str], tapped: set[str]) -> list[tuple[str, str]]:
    """Name and key expression of the estimate on a topic."""
    if topic in ("scene/truth", "cc/picture"):
        return [(parts[1], topic)]
    if parts[0] != "agent" or parts[2] not in _ESTIMATES:
        return []
    if topic in tapped:
        return [(f"{parts[1]}.received", f"{topic}/received")]
    return [(f"{parts[1]}.{_ESTIMATES[parts[2]]}", "/".join(parts[:3]))]


def _array(dtype: str, shape: list[int], data: Any) -> np.ndarray:
    if dtype == "str":
        return np.array(data, object).reshape(shape)
    return np.frombuffer(data, dtype).reshape(shape)


def _boxes(columns: dict[str, np.ndarray]) -> Boxes:
    order = np.argsort(columns["id"])
    box = np.column_stack([columns["position"], columns["size"], columns["yaw"]])[order]
    of_objects = {name: column[order] for name, column in columns.items() if len(column) == len(order)}
    return Boxes(columns["id"][order], box, of_objects)


def assert_same_boxes(found: dict[int, tuple[Any, Any]], expected: dict[int, Boxes], tolerance: float) -> None:
    """By frame, ids (n,) and boxes (n, 7) read from an export equal those recorded; yaws are compared as directions.

    tolerance: m and rad. A frame without boxes may be absent.
    """
    assert set(found) <= set(expected)
    for frame, boxes in expected.items():
        number, box = found.get(frame, ((), ()))
        number, box = np.asarray(number, np.int64), np.asarray(box, float).reshape(-1, 7)
        order = np.argsort(number)
        assert number[order].tolist() == boxes.number.tolist(), f"frame {frame}"
        np.testing.assert_allclose(box[order, :6], boxes.box[:, :6], rtol=0, atol=tolerance)
        turn = (box[order, 6] - boxes.box[:, 6] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(turn, 0, atol=tolerance)
