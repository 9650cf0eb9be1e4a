"""Ground plan of a generated junction: arms, lanes, crossings, pavements.

Traffic drives on the right. In the frame of an arm, x points away from the centre and y to its left, so that lanes
towards the centre have y > 0. Every lane away from the centre ends in a turning loop, out of sight of the junction, and
returns as the lane towards it: no vehicle leaves the scene, so a recording can have any length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import Floats
from mast_zenoh.scenes.generated.paths import Path, arc, bend, oval, rounded, straight

LANE = 3.5  # m, width of a lane
BIKE_LANE = 2.0
KERB = 5.0  # m, from where the kerbs of two arms meet to the crossing
CROSSING = 4.0  # m, width of a pedestrian crossing
REACH = 105.0  # m, where the turning loops begin
LOOP_SHIFT = 30.0  # m, over which lanes spread before the turning loop
PAVEMENT_END = 85.0
PAVEMENT = 6.0  # m, width of a pavement
OPPOSITE_DEG = 20.0  # arms within this angle of being opposite have no corner between them

#: Kinds of road users of a path.
ROAD, BIKE, CROSSER, WALKER = range(4)


@dataclass(frozen=True)
class Arm:
    """One road of the junction.

    angle: rad, direction from the centre; lanes: each way; stop: m, from the centre to the stop line
    """

    angle: float
    lanes: int
    stop: float

    @property
    def half_width(self) -> float:
        """m, from the middle of the road to its kerb."""
        return self.lanes * LANE + BIKE_LANE

    def offset(self, slot: int) -> float:
        """Distance m from the middle of the road to the middle of a lane.

        Slot `lanes` is the bicycle lane.
        """
        return (slot + 0.5) * LANE if slot < self.lanes else self.lanes * LANE + BIKE_LANE / 2

    def world(self, local: Floats) -> Floats:
        """Transform points (k, 2) m from the arm's frame to the world frame."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        rotated: Floats = local @ np.array([[c, s], [-s, c]])
        return rotated


@dataclass(frozen=True, eq=False)
class Lane:
    """One path of the plan.

    user:   ROAD, BIKE, CROSSER or WALKER
    path:   its centre line
    follow: rows of the lanes that continue it
    arm:    an approach's arm; for a connector, the arm that it comes from
    target: the arm that a connector leads to (for pedestrians, the arm of the crossing); -1 for an approach
    turn:   rad, change of direction on a connector, positive to the left
    """

    user: int
    path: Path
    follow: tuple[int, ...]
    arm: int
    target: int
    turn: float

    @property
    def connector(self) -> bool:
        """Whether the path crosses the junction or a road and needs the right of way."""
        return self.target >= 0


def arms_of(angles: list[float], lanes: list[int]) -> tuple[Arm, ...]:
    """The arms at `angles` rad (ascending) with `lanes` each way.

    Stop lines are set back behind the crossings.
    """
    unplaced = [Arm(angle, count, 0.0) for angle, count in zip(angles, lanes, strict=True)]
    arms = []
    for i, arm in enumerate(unplaced):
        left, right = unplaced[(i + 1) % len(unplaced)], unplaced[i - 1]
        mouth = 4.0
        for other, gap in ((left, left.angle - arm.angle), (right, arm.angle - right.angle)):
            gap %= 2 * np.pi
            if gap < np.pi - np.radians(OPPOSITE_DEG):
                meet = (other.half_width + arm.half_width * np.cos(gap)) / np.sin(gap)
                mouth = max(mouth, float(meet))
        arms.append(Arm(arm.angle, arm.lanes, mouth + KERB + CROSSING + 1.5))
    return tuple(arms)


def plan(arms: tuple[Arm, ...]) -> tuple[Lane, ...]:
    """All lanes of a junction with these arms."""
    lanes: list[Lane] = []
    approach: dict[tuple[int, int], int] = {}
    for a, arm in enumerate(arms):
        for slot in range(arm.lanes + 1):
            approach[a, slot] = len(lanes)
            lanes.append(Lane(BIKE if slot == arm.lanes else ROAD, _approach(arm, slot), (), a, -1, 0.0))
    for (a, slot), row in approach.items():
        for b, exit_slot in _exits(arms, a, slot):
            start = arms[a].world(np.array([[arms[a].stop, arms[a].offset(slot)]]))[0]
            end = arms[b].world(np.array([[arms[b].stop, -arms[b].offset(exit_slot)]]))[0]
            path = Path.through(bend(start, arms[a].angle + np.pi, end, arms[b].angle))
            lanes.append(Lane(lanes[row].user, path, (approach[b, exit_slot],), a, b, _turn(arms, a, b)))
            lanes[row] = _with_successor(lanes[row], len(lanes) - 1)
    for a, arm in enumerate(arms):
        lanes += _crossing(arm, a, len(lanes))
    for a in range(len(arms)):
        lanes.append(Lane(WALKER, Path.through(_pavement(arms, a)), (len(lanes),), a, -1, 0.0))
    return tuple(lanes)


def _with_successor(lane: Lane, row: int) -> Lane:
    return Lane(lane.user, lane.path, (*lane.follow, row), lane.arm, lane.target, lane.turn)


def _turn(arms: tuple[Arm, ...], a: int, b: int) -> float:
    return float(wrap_angle(np.array(arms[b].angle - arms[a].angle - np.pi)))


def _exits(arms: tuple[Arm, ...], a: int, slot: int) -> list[tuple[int, int]]:
    """Exits (arm, slot) of a lane.

    Straight from every lane, left from the inner one, right from the outer one.
    """
    arm = arms[a]
    turns = {b: _turn(arms, a, b) for b in range(len(arms)) if b != a}
    ahead = [b for b, turn in turns.items() if abs(turn) < np.radians(35)]
    left = [b for b, turn in turns.items() if turn >= np.radians(35)]
    right = [b for b, turn in turns.items() if turn <= -np.radians(35)]
    if slot == arm.lanes:
        return [(b, arms[b].lanes) for b in ahead + right]
    exits = [(b, min(slot, arms[b].lanes - 1)) for b in ahead]
    if slot == 0:
        exits += [(b, 0) for b in left]
    if slot == arm.lanes - 1:
        exits += [(b, arms[b].lanes - 1) for b in right]
    # A middle lane of a road that ends here turns left next to the inner one.
    return exits or [(b, min(slot, arms[b].lanes - 1)) for b in (left or right)[:1]]


def _approach(arm: Arm, slot: int) -> Path:
    """Out from the exit line, round the turning loop, and back to the stop line."""
    offset, radius = arm.offset(slot), 9.0 + 4.8 * slot
    t = np.linspace(0.0, 1.0, 121)
    shift = offset + (radius - offset) * (10 * t**3 - 15 * t**4 + 6 * t**5)
    spread = np.stack([REACH + LOOP_SHIFT * t, -shift], axis=1)
    out = straight(np.array([arm.stop, -offset]), spread[0])
    half = np.concatenate([out, spread])
    loop = arc(np.array([REACH + LOOP_SHIFT, 0.0]), radius, -np.pi / 2, np.pi)
    return Path.through(arm.world(np.concatenate([half, loop, half[::-1] * [1.0, -1.0]])))


def _crossing(arm: Arm, a: int, first: int) -> list[Lane]:
    """Two paths across the road, joined by a landing on each pavement.

    Pedestrians turn round on the landings.
    """
    x, half, track = arm.stop - 1.5 - CROSSING / 2, arm.half_width + 0.2, 0.9
    over = straight(np.array([x + track, -half]), np.array([x + track, half]))
    out, back = np.array([x + track, half + 0.5]), np.array([x - track, half])
    landing = np.concatenate([straight(over[-1], out), arc(np.array([x, half + 0.5]), track, 0.0, np.pi), back[None]])
    paths = []
    for mirror in (1.0, -1.0):  # the return path is the outbound path, rotated about the middle of the road
        middle = np.array([x, 0.0])
        paths += [(over - middle) * mirror + middle, (landing - middle) * mirror + middle]
    lanes = []
    for k, local in enumerate(paths):
        path = Path.through(arm.world(local))
        lanes.append(Lane(CROSSER, path, (first + (k + 1) % 4,), a, -1 if k % 2 else a, 0.0))
    return lanes


def corners(arms: tuple[Arm, ...], a: int, setback: float) -> Floats:
    """Corner (1 or 2, 2) m between the left side of arm `a` and the next arm.

    It is `setback` m behind the kerbs: one point if the sides meet, two if the arms are opposite each other.
    """
    arm, next_arm = arms[a], arms[(a + 1) % len(arms)]
    gap = (next_arm.angle - arm.angle) % (2 * np.pi)
    y, z = arm.half_width + setback, next_arm.half_width + setback
    if abs(gap - np.pi) > np.radians(OPPOSITE_DEG):
        return arm.world(np.array([[(z + y * np.cos(gap)) / np.sin(gap), y]]))
    ends = arm.world(np.array([[arm.stop + 3.0, y]])), next_arm.world(np.array([[next_arm.stop + 3.0, -z]]))
    return np.concatenate(ends)


def _pavement(arms: tuple[Arm, ...], a: int) -> Floats:
    """The loop of pedestrians walking round the corner between arm `a` and the next."""
    arm, next_arm = arms[a], arms[(a + 1) % len(arms)]
    setback = 3.5
    start = arm.world(np.array([[PAVEMENT_END, arm.half_width + setback]]))
    end = next_arm.world(np.array([[PAVEMENT_END, -next_arm.half_width - setback]]))
    return oval(rounded(np.concatenate([start, corners(arms, a, setback), end]), 5.0), 0.9)
