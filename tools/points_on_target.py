"""Counts lidar returns of road users by range: ours, those of Embree, and real ones of Argoverse 2 logs.

    python tools/points_on_target.py                          # of synthetic scans, as in docs/explanation-points.md
    python tools/points_on_target.py /data/av2_logs/*         # and of logs with annotations*.feather

Ours are beams that meet the shape; `Returns` loses some of them. Embree needs the packages embreex and trimesh.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "sensing")]

from mast_zenoh.arrays.states import CLASS_INDEX, CLASSES, Floats, Ints  # noqa: E402
from mast_zenoh.sensing.beams import MODELS, Beams  # noqa: E402
from mast_zenoh.sensing.returns import REFLECTIVITY, Returns  # noqa: E402
from mast_zenoh.sensing.scan import GROUND, Moving, cast  # noqa: E402
from mast_zenoh.sensing.shapes import Parts  # noqa: E402

SIZES = {"car": (4.5, 1.8, 1.5), "pedestrian": (0.6, 0.6, 1.75), "bicycle": (1.8, 0.7, 1.7)}
NAMES = ("VLP-16", "VLP-32C", "HDL-64E", "OS1-128")
RANGES_M, YAWS, HEIGHT_M = (10.0, 20.0, 30.0, 50.0, 70.0), 12, 1.8
#: Of Argoverse 2: m, the two lidars before, left of and above the vehicle's frame, and its origin above the ground.
AV2_LIDARS, AV2_ORIGIN = np.array([(1.35, 0.0, 1.64), (1.36, 0.0, 1.57)]), np.array([0.0, 0.0, 0.35])
AV2_BANDS_M = ((5, 10), (10, 20), (20, 30), (30, 40), (40, 60), (60, 80))
AV2_CLASSES = {"REGULAR_VEHICLE": "car", "PEDESTRIAN": "pedestrian", "BICYCLE": "bicycle", "BUS": "bus"}
LEVEL = np.eye(3)


def still(position: Floats, yaw: Floats) -> Moving:
    """What does not move."""
    return Moving(position, np.zeros_like(position), yaw, np.zeros(len(yaw)))


def counts(beams: Beams, origin: Floats, position: Floats, size: Floats, yaw: Floats, of: Ints) -> tuple[Ints, Ints]:
    """(n,) beams that meet each object, and points that `Returns` makes of them; the ground is at 0."""
    lidar = still(origin[None], np.zeros(1))
    scan = cast(beams, lidar, LEVEL, still(position, yaw), Parts.of(of, size))
    _, source = Returns().measure(scan, beams, lidar, LEVEL, REFLECTIVITY[of], np.random.default_rng(0))
    found = scan.source[scan.source >= 0]
    return np.bincount(found, minlength=len(yaw)), np.bincount(source[source >= 0], minlength=len(yaw))


def by_range() -> None:
    """Prints means over headings."""
    try:
        from test_scan_meshes import GROUND_MESH, by_embree, mesh_of
    except BaseException as error:  # pytest's own, if a package is missing
        sys.exit(f"points_on_target: {error}")
    print("| lidar | object | " + " | ".join(f"{each:.0f} m" for each in RANGES_M) + " |")
    print("|---|---|" + "---|" * len(RANGES_M))
    origin = np.array([0.0, 0.0, HEIGHT_M])
    for model in NAMES:
        beams = MODELS[model].beams(0.0)
        for name, dimensions in SIZES.items():
            of, size, cells = np.array([CLASS_INDEX[name]]), np.array([dimensions]), []
            for far in RANGES_M:
                rows = []
                for yaw in np.arange(YAWS) * np.pi / YAWS + 0.1:
                    position, heading = np.array([[far, 0.0, dimensions[2] / 2]]), np.array([yaw])
                    ours = counts(beams, origin, position, size, heading, of)
                    meshes = [mesh_of(Parts.of(of, size), 0, position[0], yaw), GROUND_MESH]
                    theirs = by_embree(beams, origin, LEVEL, meshes, [0, GROUND])[1]
                    rows.append((ours[0][0], (theirs == 0).sum(), ours[1][0]))
                cells.append(" / ".join(f"{each:.0f}" for each in np.mean(rows, axis=0)))
            print(f"| {model} | {name} | " + " | ".join(cells) + " |")


def beside_real(logs: list[Path], every: int) -> None:
    """Prints medians over the annotated objects of every n-th sweep that have returns in both."""
    from pyarrow import feather

    upright = MODELS["VLP-32C"].beams(0.0)
    down = Beams(upright.azimuth, -upright.elevation[::-1], upright.offset[::-1], upright.time_s, 0.5, 200.0)
    rows: list[Floats] = []
    for log in logs:
        table = feather.read_table(next(log.glob("annotations*.feather"))).to_pydict()
        kind = np.array([AV2_CLASSES.get(name, "") for name in table["category"]])
        column = {name: np.array(values) for name, values in table.items()}
        position = np.stack([column[f"t{axis}_m"] for axis in "xyz"], axis=1) + AV2_ORIGIN
        size = np.stack([column[f"{axis}_m"] for axis in ("length", "width", "height")], axis=1)
        yaw = 2.0 * np.arctan2(column["qz"], column["qw"])
        of = np.array([CLASSES.index(name or "unknown") for name in kind])
        for time in np.unique(column["timestamp_ns"])[::every]:
            now = (column["timestamp_ns"] == time) & (column["category"] != "EGO_VEHICLE")
            objects = position[now], size[now], yaw[now], of[now]
            both = [
                counts(beams, mount + AV2_ORIGIN, *objects)
                for beams, mount in zip((upright, down), AV2_LIDARS, strict=True)
            ]
            far = np.linalg.norm(objects[0] - (AV2_LIDARS[0] + AV2_ORIGIN), axis=1)
            made = sum(of_one[1] for of_one in both)
            rows.append(np.column_stack([objects[3], far, column["num_interior_pts"][now], made]))
    of, far, real, made = np.concatenate(rows).T
    print("| object | range | objects | real | ours | ratio | only ours | only real |")
    print("|---|---|---|---|---|---|---|---|")
    for name in ("car", "pedestrian"):
        for low, high in AV2_BANDS_M:
            some = (of == CLASS_INDEX[name]) & (far >= low) & (far < high)
            seen = some & (real > 0) & (made > 0)
            if seen.sum() < 20:
                continue
            cells = np.median(real[seen]), np.median(made[seen]), np.median(made[seen] / real[seen])
            only = ((real == 0) & (made > 0))[some].mean(), ((real > 0) & (made == 0))[some].mean()
            print(
                f"| {name} | {low}-{high} m | {some.sum()} | {cells[0]:.0f} | {cells[1]:.0f} | {cells[2]:.2f} "
                f"| {only[0]:.0%} | {only[1]:.0%} |"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="*", type=Path, help="folders of Argoverse 2 sensor logs")
    parser.add_argument("--every", type=int, default=10, help="sweeps from one that is counted to the next")
    arguments = parser.parse_args()
    beside_real(arguments.logs, arguments.every) if arguments.logs else by_range()
