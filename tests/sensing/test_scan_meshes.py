"""A scan meets what an independent caster meets on meshes: Intel Embree, through trimesh, in single precision."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from mast_zenoh.arrays.states import CLASS_INDEX, Floats, Ints
from mast_zenoh.sensing import scan
from mast_zenoh.sensing.beams import MODELS, Beams
from mast_zenoh.sensing.raycast import Walls
from mast_zenoh.sensing.shapes import Parts

trimesh = pytest.importorskip("trimesh", reason="the independent caster is not installed")
pytest.importorskip("embreex", reason="the independent caster is not installed")

#: m, length width height, by class.
SIZES = {"car": (4.5, 1.8, 1.5), "truck": (8.0, 2.4, 3.0), "bicycle": (1.8, 0.7, 1.7), "pedestrian": (0.6, 0.6, 1.75)}
LEVEL = np.eye(3)
#: m: single precision of Embree at these ranges.
FLOAT32_M = 2e-3


def mesh_of(parts: Parts, row: int, position: Floats, yaw: float) -> tuple[Floats, Ints]:
    """Corners and triangles of an object: the convex hull of each part."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    corners, faces, count = [], [], 0
    for part in range(parts.first[row], parts.first[row + 1]):
        both = parts.low[part], parts.high[part]
        some = np.array([(x, y, z) for z, *sides in both for x in sides[:2] for y in sides[2:]])
        corners.append(some @ turn.T + position)
        faces.append(ConvexHull(some).simplices + count)
        count += len(some)
    return np.concatenate(corners), np.concatenate(faces)


def walls_as_mesh(walls: Walls) -> tuple[Floats, Ints]:
    corners = np.concatenate(
        [
            [(*start, -100.0), (*end, -100.0), (*end, top), (*start, top)]
            for start, end, top in zip(walls.start, walls.end, walls.top, strict=True)
        ]
    )
    return corners, np.concatenate(
        [[(4 * k, 4 * k + 1, 4 * k + 2), (4 * k, 4 * k + 2, 4 * k + 3)] for k in range(len(walls.top))]
    )


GROUND_MESH = (
    np.array([(x, y, 0.0) for x, y in ((-1e3, -1e3), (1e3, -1e3), (1e3, 1e3), (-1e3, 1e3))]),
    np.array([(0, 1, 2), (0, 2, 3)]),
)


def by_embree(
    beams: Beams, origin: Floats, rotation: Floats, meshes: list[tuple[Floats, Ints]], sources: list[int]
) -> tuple[Floats, Ints, Floats]:
    """Range m, source and cosine (m, c) of a lidar that is still; `sources`: of each mesh."""
    first = np.cumsum([0, *(len(corners) for corners, _ in meshes)])
    mesh = trimesh.Trimesh(
        np.concatenate([corners for corners, _ in meshes]),
        np.concatenate([faces + start for (_, faces), start in zip(meshes, first, strict=False)]),
        process=False,
    )
    caster = trimesh.ray.ray_pyembree.RayMeshIntersector(mesh, scale_to_box=False)
    beam = (beams.directions() @ rotation.T).reshape(-1, 3)
    triangle = caster.intersects_first(np.tile(origin, (len(beam), 1)), beam)
    met = triangle >= 0
    normal, corner = mesh.face_normals[triangle], mesh.triangles[triangle, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.einsum("ij,ij->i", beam, normal)
        distance = np.where(met, np.einsum("ij,ij->i", corner - origin, normal) / along, np.inf)
    owner = np.repeat(sources, [len(faces) for _, faces in meshes])[triangle]
    met &= distance <= beams.max_range_m
    shape = len(beams.azimuth), len(beams.elevation)
    return (
        np.where(met, distance, np.inf).reshape(shape),
        np.where(met, owner, scan.NOTHING).reshape(shape),
        np.where(met, np.abs(along), 0.0).reshape(shape),
    )


@pytest.mark.parametrize("model", sorted(MODELS))
def test_a_scan_of_traffic_walls_and_ground_is_that_of_embree(model: str) -> None:
    draw = np.random.default_rng(7)
    beams = MODELS[model].beams(0.0)
    names = draw.choice(sorted(SIZES), 25)
    size = np.array([SIZES[name] for name in names])
    position = np.column_stack([draw.uniform(-40.0, 40.0, (25, 2)), size[:, 2] / 2])
    position[:, :2] += 4.0 * np.sign(position[:, :2])  # not upon the lidar
    yaw = draw.uniform(-np.pi, np.pi, 25)
    parts = Parts.of(np.array([CLASS_INDEX[name] for name in names]), size)
    walls = Walls.of_buildings((np.array([(12.0, 30.0), (35.0, 30.0), (35.0, 50.0), (12.0, 50.0)]),), np.array([6.0]))
    pitch = 0.05
    mount = np.array([[np.cos(pitch), 0.0, np.sin(pitch)], [0.0, 1.0, 0.0], [-np.sin(pitch), 0.0, np.cos(pitch)]])
    still = np.zeros((25, 3))
    origin = np.array([0.0, 0.0, 1.9])
    found = scan.cast(
        beams,
        scan.Moving(origin[None], np.zeros((1, 3)), np.zeros(1), np.zeros(1)),
        mount,
        scan.Moving(position, still, yaw, np.zeros(25)),
        parts,
        walls=walls,
    )
    meshes = [mesh_of(parts, row, position[row], yaw[row]) for row in range(25)]
    meshes += [walls_as_mesh(walls), GROUND_MESH]
    range_m, source, cosine = by_embree(beams, origin, mount, meshes, [*range(25), scan.WALL, scan.GROUND])
    same = found.source == source
    assert same.mean() > 0.9995  # beams at an edge may pass it in single precision
    both = same & np.isfinite(range_m)
    assert both.sum() > 0.2 * both.size
    assert np.abs(found.range_m[both] - range_m[both]).max() < FLOAT32_M
    on_object = both & (source >= 0)
    agrees = np.abs(found.cosine - cosine)[on_object] < 1e-3
    assert agrees.mean() > 0.995  # at an edge of two faces either is met


@pytest.mark.parametrize("model", ["VLP-16", "OS1-128"])
@pytest.mark.parametrize("name", sorted(SIZES))
@pytest.mark.parametrize("distance", [10.0, 25.0])
def test_points_on_target_are_those_of_embree(model: str, name: str, distance: float) -> None:
    beams = MODELS[model].beams(0.0)
    size = np.array([SIZES[name]])
    parts = Parts.of(np.array([CLASS_INDEX[name]]), size)
    target, origin = np.array([[distance, 0.0, size[0, 2] / 2]]), np.array([0.0, 0.0, 1.8])
    found = scan.cast(
        beams,
        scan.Moving(origin[None], np.zeros((1, 3)), np.zeros(1), np.zeros(1)),
        LEVEL,
        scan.Moving(target, np.zeros((1, 3)), np.array([0.5]), np.zeros(1)),
        parts,
    )
    _, source, _ = by_embree(beams, origin, LEVEL, [mesh_of(parts, 0, target[0], 0.5), GROUND_MESH], [0, scan.GROUND])
    assert (found.source == 0).sum() > 0
    assert abs(int((found.source == 0).sum()) - int((source == 0).sum())) <= 2
