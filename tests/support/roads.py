"""Straight roads, cars on them, and what a driver knows of both."""

import numpy as np

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.driving import RouteAhead, Situation

LENGTH, WIDTH = 4.5, 1.9


def straight(x: float, limit: float, stop_m: float = np.inf) -> RouteAhead:
    """80 m of a lane along the x axis."""
    points = np.column_stack([x + np.arange(81.0), np.zeros(81)])
    return RouteAhead(points, np.full(81, limit), stop_m)


def cars(*rows: tuple[float, float, float]) -> ObjectStates:
    """Cars on the x axis or beside it, by (x, y, speed)."""
    table = np.array(rows, np.float64).reshape(-1, 3)
    n = len(table)
    return ObjectStates.of(
        np.column_stack([table[:, :2], np.zeros(n)]),
        velocity=np.column_stack([table[:, 2], np.zeros((n, 2))]),
        size=np.tile([LENGTH, WIDTH, 1.5], (n, 1)),
    )


def situation(
    x: float, speed: float, objects: ObjectStates, route: RouteAhead, y: float = 0.0, yaw: float = 0.0
) -> Situation:
    """What a driver knows at x, y with a heading."""
    velocity = speed * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    return Situation(0, np.array([x, y, 0.0]), velocity, yaw, np.array([LENGTH, WIDTH]), route, objects)
