"""Reads optional files next to a recorded scene: visibility and buildings.

See docs/scenes.md.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.errors import SceneError
from mast_zenoh.scenes.files.json_lines import lines_of_agents, reason, reject_constant

_DEFAULT_HEIGHT_M = 12.0  # of buildings


def read_visibility(
    path: Path, frames: Sequence[int], agents: Sequence[int], ids: Ints, start: Ints
) -> NDArray[np.int32]:
    """(N, A) lidar returns of each truth row at each agent, from `visibility.jsonl`.

    ids (N,) and start (F + 1,): the truth rows. Objects that are not listed have no returns.
    """
    points = np.zeros((len(ids), len(agents)), np.int32)
    for place, frame, agent, data in lines_of_agents(path, frames, agents, "objects"):
        row = {int(i): k for k, i in enumerate(ids[start[frame] : start[frame + 1]], start=int(start[frame]))}
        try:
            for entry in data:
                if int(entry[0]) not in row:
                    raise ValueError(f"object {entry[0]} is not in the scene in this frame")
                if int(entry[1]) < 0:
                    raise ValueError(f"object {entry[0]} has {entry[1]} points, expected 0 or more")
                points[row[int(entry[0])], agent] = int(entry[1])
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise SceneError(f"{place}: {reason(error)}") from error
    return points


def read_buildings(path: Path, scene: Path | None) -> tuple[tuple[Floats, ...], Floats]:
    """Outlines, each (k, 2) m, and heights (B,) m, from `buildings.json`.

    The polygons are in the world frame. All have the height `building_height_m` of `scene.json`, by default 12 m.
    """
    data = _load(path)
    settings = _load(scene) if scene is not None else {}
    outlines = []
    try:
        height = float(settings.get("building_height_m", _DEFAULT_HEIGHT_M))
        for index, polygon in enumerate(data):
            outline = np.array(polygon, np.float64)
            if outline.ndim != 2 or outline.shape[1:] != (2,) or not np.isfinite(outline).all():
                raise ValueError(f"polygon {index}: expected [[x, y], ...], finite")
            if np.array_equal(outline[0], outline[-1]):
                outline = outline[:-1]
            if len(outline) < 3:
                raise ValueError(f"polygon {index} has {len(outline)} corners, expected at least 3")
            outlines.append(outline)
    except (ValueError, TypeError, AttributeError, IndexError) as error:
        raise SceneError(f"{path}: {reason(error)}") from error
    return tuple(outlines), np.full(len(outlines), height)


def _load(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=reject_constant)
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: {error}") from error
