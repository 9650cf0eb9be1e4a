"""Scenes from NumPy arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASS_INDEX, Floats
from mast_zenoh.errors import SceneError, nearest
from mast_zenoh.scenes.making.assembly import (
    AgentPath,
    SceneBoxes,
    assemble,
    direction_of_motion,
    fill_velocity,
    pole,
    vehicle,
)
from mast_zenoh.scenes.making.sensor_types import SensorsByAgent
from mast_zenoh.scenes.recording import Recording, check_times
from mast_zenoh.sensing import DetectionModel, Detector

_DETECTOR = DetectionModel()


def from_arrays(
    *,
    times_s: ArrayLike,
    position: ArrayLike,
    size: ArrayLike = (4.5, 1.8, 1.5),
    agents: Sequence[int] = (0,),
    yaw: ArrayLike | None = None,
    kinds: str | Sequence[str] = "car",
    poles: ArrayLike = (),
    points: ArrayLike | None = None,
    buildings: Sequence[ArrayLike] = (),
    building_height: float = 12.0,
    detector: Detector = _DETECTOR,
    sensors: SensorsByAgent | None = None,
    name: str = "arrays",
    seed: int = 0,
    frames: int | None = None,
) -> Recording:
    """Record the trajectories of M objects over F frames, some of which are agents.

    times_s:   (F,) s, ascending
    position:  (F, M, 3) m, world frame, middle of the boxes; or (F, M, 2) for boxes on the ground z = 0. NaN: the
               object is not there in this frame
    size:      (3,) or (M, 3) m, length, width, height
    agents:    objects (0 to M - 1) with a lidar on the roof, the ego first; there in every frame
    yaw:       (F, M) rad; None: the direction of motion
    kinds:     class of all objects, or of each: car, truck, bus, motorcycle, bicycle, pedestrian, unknown
    poles:     (P, 3) x m, y m and heading rad of poles 15 m above the ground, whose lidars look 30 degrees down
    points:    (F, M, agents and poles) lidar returns of each object at each agent; None: by ray casting
    buildings: outlines, each (k, 2) m, world frame; building_height: m, of all
    detector:  the model that generates detections from what the agents see
    sensors:   of agents, by name ("ego", "mobile_1", "infra_1") or pattern; None: a lidar each
    name:      of the scene
    seed:      of the detector; frames: how many to record, the first ones; None: all

    Raises SceneError with the array and the place in it that is invalid, and ConfigurationError for `frames`.
    """
    times = _array(name, "times_s", times_s, (None,))
    place = _array(name, "position", position, (len(times), None, None), gaps=True)
    objects = place.shape[1]
    if place.shape[2] not in (2, 3) or not len(times):
        raise SceneError(f"{name}: position has shape {place.shape}, expected (frames, objects, 2 or 3)")
    sizes = np.broadcast_to(_array(name, "size", size, (3,) if np.ndim(size) == 1 else (objects, 3)), (objects, 3))
    headings = None if yaw is None else _array(name, "yaw", yaw, (len(times), objects), gaps=True)
    beside = _array(name, "poles", np.reshape(poles, (-1, 3)) if np.size(poles) == 0 else poles, (None, 3))

    times_ns = np.round(times * 1e9).astype(np.int64)
    check_times(name, times_ns)
    frame, number = np.nonzero(np.isfinite(place).all(axis=2))
    there = place[frame, number]
    if place.shape[2] == 2:
        there = np.column_stack([there, sizes[number, 2] / 2])
    velocity = fill_velocity(number, there, np.full_like(there, np.nan), times_ns[frame])
    turned = direction_of_motion(number, velocity) if headings is None else headings[frame, number]
    classes = _classes(name, kinds, objects)
    boxes = SceneBoxes(frame, number, there, sizes[number], wrap_angle(turned), classes[number], velocity)
    boxes.validate(name, len(times))

    paths = [_agent(name, boxes, row, agent, len(times)) for row, agent in enumerate(agents)]
    paths += [pole(f"infra_{k}", boxes, row[:2], row[2], len(times)) for k, row in enumerate(beside, start=1)]
    if points is not None:
        returns = _array(name, "points", points, (len(times), objects, len(paths)))
        seen = returns[frame, number].astype(np.int32)
        paths = [replace(path, points=seen[:, column]) for column, path in enumerate(paths)]
    outlines = tuple(_array(name, f"buildings[{k}]", outline, (None, 2)) for k, outline in enumerate(buildings))
    walls: dict[str, Any] = dict(buildings=outlines, building_height=np.full(len(outlines), float(building_height)))
    return assemble(name, times_ns, boxes, paths, detector, seed=seed, frames=frames, sensors=sensors, **walls)


def _array(name: str, argument: str, values: ArrayLike, shape: tuple[int | None, ...], gaps: bool = False) -> Floats:
    """An argument as float64 of a shape (None: any length); gaps: NaN is allowed."""
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{name}: {argument} is not an array of numbers: {error}") from None
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        expected = ", ".join("any" if n is None else str(n) for n in shape)
        raise SceneError(f"{name}: {argument} has shape {array.shape}, expected ({expected})")
    invalid = np.argwhere(np.isinf(array) if gaps else ~np.isfinite(array))
    if len(invalid):
        where = tuple(invalid[0].tolist())
        raise SceneError(f"{name}: {argument}{list(where)} is {array[where]}, expected a finite number")
    return array


def _classes(name: str, kinds: str | Sequence[str], objects: int) -> NDArray[np.uint8]:
    """(M,) index into CLASSES of each object."""
    each = [kinds] * objects if isinstance(kinds, str) else list(kinds)
    if len(each) != objects:
        raise SceneError(f"{name}: kinds has {len(each)} classes, expected {objects}")
    for kind in each:
        if kind not in CLASS_INDEX:
            raise SceneError(f"{name}: kinds has {kind!r}, which is no class{nearest(str(kind), CLASS_INDEX)}")
    return np.array([CLASS_INDEX[kind] for kind in each], np.uint8)


def _agent(name: str, boxes: SceneBoxes, row: int, number: int, frames: int) -> AgentPath:
    """The agent in a row of `agents`."""
    count = int((boxes.id == number).sum())
    if count != frames:
        raise SceneError(
            f"{name}: agents[{row}] is object {number}, which is there in {count} of {frames} frames, expected all"
        )
    return vehicle("ego" if row == 0 else f"mobile_{row}", boxes, number)
