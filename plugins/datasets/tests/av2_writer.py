"""Writes a small log in the layout of Argoverse 2."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import feather

FRAMES = 5
POSES, BOXES = "city_SE3_egovehicle.feather", "annotations.feather"


def poses() -> dict[str, Any]:
    """A car that drives north at 10 m/s, 60 m above sea level; poses at 20 Hz."""
    rows = np.arange(2 * FRAMES)
    pose = dict(qw=np.cos(np.pi / 4), qx=0.0, qy=0.0, qz=np.sin(np.pi / 4), tx_m=5000.0, ty_m=2000.0 + 0.5 * rows)
    columns = {name: value + np.zeros(len(rows)) for name, value in (pose | {"tz_m": 60.0}).items()}
    return {"timestamp_ns": 10**18 + 50_000_000 * rows} | columns


def boxes() -> dict[str, Any]:
    """In every frame a bus 20 m ahead, a cone, and a pedestrian 10 m to the left."""
    rows = [("bus-1", "BUS", 20.0, 0.0, 3.0, 90), ("cone", "CONSTRUCTION_CONE", 5.0, 2.0, 0.8, 30)]
    rows += [("a-person", "PEDESTRIAN", 0.0, 10.0, 1.8, 3), ("ego", "EGO_VEHICLE", 0.0, 0.0, 1.5, 1)]
    table = [(10**18 + 100_000_000 * frame, *row) for frame in range(FRAMES) for row in rows]
    time, track, category, x, y, height, points = map(list, zip(*table, strict=True))
    columns = {"timestamp_ns": np.array(time), "track_uuid": track, "category": category}
    for name, of_bus in (("length_m", 12.0), ("width_m", 2.5)):
        columns[name] = np.array([of_bus if kind == "BUS" else 0.8 for kind in category])
    columns |= {"height_m": np.array(height), "qw": np.ones(len(table))}
    columns |= {name: np.zeros(len(table)) for name in ("qx", "qy", "qz")}
    columns |= {"tx_m": np.array(x), "ty_m": np.array(y), "tz_m": np.array(height) / 2 - 0.33}
    return columns | {"num_interior_pts": np.array(points)}


def write(folder: Path, name: str, columns: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pyarrow.table(columns), folder / name)


def write_log(folder: Path) -> Path:
    write(folder, POSES, poses())
    write(folder, BOXES, boxes())
    return folder
