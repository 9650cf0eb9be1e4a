"""The recording for the Rerun viewer, read back by Rerun's RrdReader."""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_record import PlainRecord, assert_same_boxes

import mast_zenoh as mast


@pytest.fixture(scope="module")
def reader(exported_to: Callable[[str], Path]) -> Any:
    from rerun.chunk import RrdReader  # slow, and nothing else needs it

    return RrdReader(exported_to("rrd"))


@pytest.fixture(scope="module")
def rows(reader: Any) -> dict[str, list[dict[str, Any]]]:
    """By entity, its rows, with components by name."""
    result: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for chunk in reader.stream():
        result[chunk.entity_path.lstrip("/")] += chunk.to_record_batch().to_pylist()
    return result


def without_times(chunk: Any) -> list[dict[str, Any]]:
    """The rows of a chunk of a blueprint, whose only time is that of the export."""
    batch = chunk.to_record_batch()
    return list(batch.drop_columns(chunk.timeline_names).to_pylist())


def by_frame(rows: list[dict[str, Any]]) -> dict[int, dict[str, Any]]:
    """The row of each frame, which is the only one."""
    frames = {row["frame"]: row for row in rows if row.get("frame") is not None}
    assert len(frames) == len([row for row in rows if row.get("frame") is not None])
    return frames


def test_every_estimate_is_an_entity_with_a_batch_of_boxes_a_frame(rows: Any, record: PlainRecord) -> None:
    for name, topic in record.topics.items():
        found = {}
        for frame, row in by_frame(rows[topic]).items():
            numbers = [int(label.split(",")[0].split()[-1]) for label in row["Boxes3D:labels"]]
            centres, halves = (
                np.reshape(row["Boxes3D:centers"], (-1, 3)),
                np.reshape(row["Boxes3D:half_sizes"], (-1, 3)),
            )
            x, y, z, w = np.reshape(row["Boxes3D:quaternions"], (-1, 4)).T
            assert not x.any()
            assert not y.any()
            found[frame] = numbers, np.column_stack([centres, 2 * halves, 2 * np.arctan2(z, w)])
        assert set(found) == set(record.frames)
        assert_same_boxes(found, record.boxes[name], 1e-4)  # Rerun has 32 bits for a number


def test_poses_are_those_recorded(rows: Any, record: PlainRecord) -> None:
    for agent, poses in record.poses.items():
        frames = by_frame(rows[f"agent/{agent}/pose"])
        assert set(frames) == set(record.frames)
        for frame, row in frames.items():
            position, (w, x, y, z) = poses[frame]
            np.testing.assert_allclose(row["Transform3D:translation"][0], position, atol=1e-4)
            matrix = np.reshape(row["Transform3D:mat3x3"][0], (3, 3)).T  # by columns
            n = 2 / (w * w + x * x + y * y + z * z)
            ahead = [1 - n * (y * y + z * z), n * (x * y + w * z), n * (x * z - w * y)]
            np.testing.assert_allclose(matrix[:, 0], ahead, atol=1e-5)


def test_no_boxes_are_below_an_entity_with_a_pose(rows: Any, record: PlainRecord) -> None:
    """Entities inherit the transforms of those above them, and all boxes are in the world frame."""
    posed = [path for path, of in rows.items() if any("Transform3D:translation" in row for row in of)]
    assert posed
    for topic in record.topics.values():
        assert not any(topic.startswith(path) for path in posed)


def test_scores_log_and_inserted_objects_are_there(rows: Any, recorded: mast.Run) -> None:
    table = [row for row in recorded.metrics.to_pylist() if (row["agent"], row["estimator"]) == ("ego", "picture")]
    series = by_frame(rows["scores/ego/picture/fp"])
    assert [series[row["frame"]]["Scalars:scalars"] for row in table] == [[row["fp"]] for row in table]
    effects = [row for row in recorded.attacks.to_pylist() if row["role"] == "adversary"]
    assert len(rows["log"]) == len(effects)
    inserted = sum(row["effect"] == "inserted" for row in effects)
    labels = [label for row in by_frame(rows["changes"]).values() for label in row["Points3D:labels"] or ()]
    assert sum(label.startswith("inserted by") for label in labels) == inserted > 20


def test_the_blueprint_shows_entities_of_the_file(reader: Any, rows: Any) -> None:
    (blueprint,) = reader.blueprints()
    assert blueprint.application_id == reader.recordings()[0].application_id == "mast-zenoh"
    content = [row for chunk in reader.stream(store=blueprint) for row in without_times(chunk)]
    kinds = {row["ViewBlueprint:class_identifier"][0] for row in content if row.get("ViewBlueprint:class_identifier")}
    assert kinds == {"3D", "2D", "TimeSeries", "TextLog"}
    queries = [query for row in content for query in row.get("ViewContents:query") or ()]
    shown = {query.removeprefix("+ /").removesuffix("/**") for query in queries if query.startswith("+ /")}
    assert {"cc/picture", "scene/truth", "cc/picture/missed", "scores/ego/picture/fp"} <= shown
    assert shown <= set(rows)
