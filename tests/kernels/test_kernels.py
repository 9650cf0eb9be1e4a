"""Compiled kernels equal their NumPy references, which replace missing ones."""

import copy
import dataclasses
import importlib
import os
import pkgutil
import re
import shutil
import subprocess
import sys
import tarfile
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import msgpack
import numpy as np
import pytest
import uper_oracle
from hypothesis import given
from hypothesis import strategies as st
from plain_values import from_plain
from v2x_messages import MessageMaker
from v2x_messages import damaged as damaged_message

import mast_zenoh
from mast_zenoh import kernels
from mast_zenoh.arrays import matching
from mast_zenoh.arrays.geometry import rotation_from_yaw_pitch
from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks import following
from mast_zenoh.fusion.pipelines import mission
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import Tolerances
from mast_zenoh.messages import codec
from mast_zenoh.messages.layout import LAYOUTS, limit_of
from mast_zenoh.messages.schemas import SCHEMAS, Header
from mast_zenoh.sensing import LidarSensor, Walls, lidar_points, returns, scan
from mast_zenoh.sensing.beams import Beams
from mast_zenoh.sensing.raycast import PlacedSensor
from mast_zenoh.sensing.shapes import Parts
from mast_zenoh.tracking import SensorView, association, classes, tracks
from mast_zenoh.tracking.existence import STAGES_S
from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.asn1 import uper

for package in ("tracking", "fusion", "fusion.pipelines", "metrics", "sensing", "attacks", "integrity"):
    for module in pkgutil.iter_modules([str(Path(mast_zenoh.__file__).parent / package.replace(".", "/"))]):
        importlib.import_module(f"mast_zenoh.{package}.{module.name}")

DATA = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[3] / "shared" / "data")
compiled = pytest.mark.skipif(not kernels.COMPILED, reason="no kernels were compiled here (no C compiler?)")


def covariances(random, n, k=9):
    root = random.normal(size=(n, k, k)) * random.choice([0.0, 1.0], (n, k, k))
    return root @ root.transpose(0, 2, 1) + 0.1 * np.eye(k)


def places(random, n):
    """Points, some coincident or collinear."""
    spread = random.choice([0.5, 5.0, 50.0])
    points = random.normal(0.0, spread, (n, 3))
    return np.round(points) if random.random() < 0.3 else points


def table(random, n):
    t = tracks.empty(n)
    t[:, tracks.MEAN] = np.hstack([places(random, n), random.uniform(0.3, 5, (n, 3)), random.normal(0, 4, (n, 3))])
    t[:, tracks.COVARIANCE] = covariances(random, n).reshape(n, 81)
    t[:, tracks.YAW], t[:, tracks.YAW_VARIANCE] = random.uniform(-9, 9, n), random.uniform(1e-3, 0.3, n)
    t[:, tracks.TURN], t[:, tracks.LATERAL_RESIDUAL] = random.integers(0, 6, n), random.normal(0, 0.3, n)
    t[:, tracks.ODDS], t[:, tracks.AGE] = np.exp(random.uniform(-9, 25, n)), random.uniform(0, 4, n)
    t[:, tracks.RECORD] = random.uniform(0, 9, (n, 9)).round(random.integers(0, 3))
    t[:, tracks.CLASS], t[:, tracks.CONFIRMED] = random.integers(0, 7, n), random.integers(0, 2, n)
    t[:, tracks.ID], t[:, tracks.ROW] = np.arange(n), random.integers(-1, 9, n)
    return t


def staged(random, n):
    """Tracks with scores, spans, and stages that are due, some of them negated or over."""
    t = table(random, n)
    t[:, tracks.SCORE], t[:, tracks.SPAN] = random.uniform(0, 1, n).round(1), random.uniform(0, 3, n).round(1)
    t[:, tracks.DUE] = random.choice([*STAGES_S, np.inf], n) * random.choice([-1.0, 1.0], n)
    return t


def ordered_boxes(random, n, m):
    columns = (
        places(random, n), random.uniform(0.3, 5, (n, 3)), random.uniform(-9, 9, n),
        random.integers(0, 256, n).astype(np.uint8), random.random(n),
        random.normal(size=(n, 3, 3)) * random.choice([0.0, 1.0, 1e5]),
    )  # fmt: skip
    return random.permutation(n), columns, random.uniform(0.1, 1, 6), 1e-4, 1e8


def measured(random, n):
    """The fields of `MeasurementBatch`."""
    k = random.choice([6, 9])
    columns = random.permutation(n), random.normal(size=(n, k)), covariances(random, n, k)
    return *columns, random.uniform(-9, 9, n), random.integers(0, 7, n), random.random(n)


def new_tracks(random, n, m):
    return random.random(n) < 0.5, measured(random, n), m, (0.01, 0.03, 0.5), classes.FIRST_SPEED


def matched_tracks(random, n, m):
    k = min(n, m)
    match = random.permutation(n)[:k], random.permutation(m)[:k], random.normal(0, 5, k), random.choice([0.0, 1.5], k)
    numbers = 0.01, 1e12, bool(random.random() < 0.5)
    return staged(random, n), match, random.uniform(0.1, 0.9, n), measured(random, m), *numbers


def averaged(random, n, m):
    k = min(n, m)
    pairs = (
        random.normal(size=(k, 9)), covariances(random, k), covariances(random, k), random.uniform(-4, 4, k),
        random.random(k), random.normal(size=(k, 9)),
    )  # fmt: skip
    picture = random.normal(size=(n, 9)), random.uniform(-4, 4, n), covariances(random, n)
    return *picture, random.permutation(n)[:k], pairs, mission.WEIGHTING


def pairs(random, n, m):
    indices = np.flatnonzero(random.random(n * m) < 0.4) if n and m else np.zeros(0, np.int64)
    return indices // max(m, 1), indices % max(m, 1)


def gated_pairs(random, n, m):
    t, position = table(random, n), places(random, m)
    i, j = pairs(random, n, m)
    dx, dy = (position[j, axis] - t[i, axis] for axis in (0, 1))
    boxes = position, covariances(random, m, 6), random.integers(0, 7, m)
    jump = random.uniform(0, random.choice([2.0, 200.0]), 7)
    model = association.AssociationModel(jump, -4.6, -9.9, classes.CONFUSION)
    return t, random.uniform(0.1, 0.98, n), boxes, (i, j, dx, dy), association.GATE, model


def near_pairs(random, n):
    """Tracks of agents, and all or some of the pairs of them within a radius."""
    position, agent, radius = places(random, n)[:, :2], random.integers(0, 9, n), random.choice([0.5, 2.0, 9.0])
    i, j, squared = matching.pairs_near(position, radius)
    some = random.random(len(i)) < random.choice([0.7, 1.0])
    return position, agent, i[some], j[some], squared[some], random.choice([radius, np.inf])


def tracks_of_agents(random, n, m):
    """Positions and velocities of up to n agents' tracks of up to m objects, and bounds of a group."""
    agent, of = (random.random((n, m)) < 0.8).nonzero()
    motion = np.concatenate([places(random, m), places(random, m)], axis=1)[of]
    motion += random.normal(0.0, random.choice([0.0, 0.2, 0.6]), motion.shape)
    if random.random() < 0.3:
        motion = np.round(motion)  # at the borders of cells, and at the radius
    return motion, agent, np.repeat([5.6, 2.0], 3), random.choice([0.5, 1.0, 2.0]), random.choice([5.0, 27.86, np.inf])


def scattered_tracks(random, n, m):
    """Tracks of agents, their covariances, and bounds of a cluster."""
    motion, agent, inverse_bias, radius, gate = tracks_of_agents(random, n, m)
    covariance = covariances(random, len(agent), 6)
    most, crowd = int(random.choice([10, 2000])), int(random.choice([3, 256]))
    return motion, agent, covariance, 1.0 / inverse_bias, radius, gate, most, crowd


def cluster_tracks(random, n):
    """Motions, covariances, agents and labels of tracks in clusters, sorted."""
    agent, label = (random.random((n, 4)) < 0.7).nonzero()
    order = np.lexsort((agent, label))
    variances, covariance = random.uniform(0.5, 1.0, (2, len(order), 2, 2))
    spread = np.concatenate([variances, 0.1 * covariance], axis=2).reshape(-1, 8)
    return random.normal(size=(len(order), 4)), spread, agent[order], label[order], n, int(random.choice([1, 3, 32]))


def clusters(random, n):
    """Start rows of groups with n >= 1 members."""
    return np.unique(np.append(0, random.integers(0, n, n // 2)))


def view(random, n, m):
    azimuth = (-np.pi, np.pi) if random.random() < 0.5 else (-1.0, 0.6)
    rotation = np.linalg.qr(random.normal(size=(3, 3)))[0]
    sensor = SensorView(random.normal(size=3), rotation, *azimuth, -0.5, 0.3, 60.0)
    return boxes(random, n), boxes(random, m), sensor, 2.5, 0.1


def swept(random, n, m):
    sensor = view(random, n, m)[2]
    free = random.uniform(1, 90, (int(random.integers(0, 6)), int(random.integers(1, 40))))
    return places(random, n), sensor, free if len(free) else np.zeros((0, 0))


def looked_at(random, n, m):
    """Boxes and views of them, and for some calls the one view that is asked about each box."""
    views = [None, *(SweptView(*swept(random, 0, 0)[1:], random.choice([0.0, 0.3])) for _ in range(3))]
    only = random.integers(0, len(views), n) if random.random() < 0.5 else None
    return (places(random, n), random.uniform(0.3, 6, (n, 3)), random.uniform(-4, 4, n)), views, only, Tolerances()


def box_visibility(random, n, m):
    around, *others = looked_at(random, n, m)
    return *around, random.uniform(0, 2, n), *others


def ray_evidence(random, n, m):
    (position, *around), *others = looked_at(random, n, m)
    return position, random.normal(0, 9, (n, 3)), *around, *others


def outside_view(random, n, m):
    around, views, only, tolerances = looked_at(random, n, m)
    only = random.integers(0, len(views), n) if only is None else only
    return *around, random.uniform(0, 3, n), views, only, tolerances


def passed_beside(random, n, m):
    around, views, _, tolerances = looked_at(random, n, m)
    return *around, views, tolerances


def looked_for(random, n, m):
    """Objects that are not there, a sensor that would see them, and what is in the way."""
    around, others = (places(random, n), random.uniform(0.3, 6, (n, 3)), random.uniform(-4, 4, n)), places(random, m)
    size, yaw = random.uniform(0.3, 6, (m, 3)), random.uniform(-4, 4, m)
    states = ObjectStates.of(others, id=np.arange(m), size=size, yaw=yaw, velocity=np.zeros((m, 3)))
    lidar = LidarSensor(azimuth_step_deg=random.choice([0.5, 0.7]), elevation_max_deg=30.0, channels=20)
    sensor = PlacedSensor(lidar, random.normal(0, 5, 3), rotation_from_yaw_pitch(*random.uniform(-1, 1, 2)), m // 2)
    walls = Walls(random.normal(0, 30, (m, 2)), random.normal(0, 30, (m, 2)), random.uniform(-1, 9, m))
    return *around, sensor, walls if random.random() < 0.8 else None, states, int(random.integers(0, 20))


def cast(random, n, m):
    """A lidar among boxes and walls, on one of the boxes or on none."""
    position, yaw, pitch = places(random, n), random.uniform(-4, 4, n), random.uniform(-1, 1)
    if random.random() < 0.5:  # traffic: side by side, seen by a lidar that stands upright
        position[:, 1], yaw, pitch = random.integers(-2, 3, n) * 3.5, random.normal(0, 0.05, n), 0.0
    boxes = position, random.uniform(0.3, 6, (n, 3)), yaw
    step = random.choice([0.5, 0.7])  # 0.7: beams after a turn are not at the same places
    lidar = LidarSensor(
        azimuth_step_deg=step, elevation_max_deg=30.0, channels=20, max_range_m=random.choice([9.0, 90.0])
    )
    pose = random.normal(0, 5, 3), rotation_from_yaw_pitch(random.uniform(-1, 1), pitch)
    walls = Walls(random.normal(0, 30, (m, 2)), random.normal(0, 30, (m, 2)), random.uniform(-1, 9, m))
    return lidar, *pose, *boxes, walls if random.random() < 0.8 else None, int(random.integers(-1, n)) if n else -1


def members(random, n, m):
    """Rows (c, a) of n tracks in clusters, at most one of each agent, and none empty."""
    labels = np.unique(random.integers(0, m + 1, n), return_inverse=True)[1] if n else np.zeros(0, np.int64)
    agent = np.array([int((labels[:row] == labels[row]).sum()) for row in range(n)], np.int64)
    table = np.full((len(set(labels.tolist())), int(agent.max(initial=0)) + 2), -1, np.int64)
    table[labels, agent] = np.arange(n)
    return table


def median_boxes(random, n, m):
    member = members(random, n, m)
    return places(random, n), places(random, n), places(random, n), random.uniform(-4, 4, n), member, member >= 0


def weighted_medians(random, n, m):
    member = members(random, n, m)
    weight = np.where(member >= 0, random.choice([0.0, 0.05, 0.5, 1.0], member.shape), 0.0)
    weight[np.arange(len(member)), member.argmax(axis=1)] = 0.5  # of one member at least
    return table(random, n), member, weight


def boxes(random, n):
    return table(random, n)[:, :6]


def overlap(random, n, m):
    size, other = (random.uniform(0.5, 6, (n, 3)) for _ in range(2))
    return random.normal(0, 2, (n, 2)), size, random.uniform(-4, 4, n), other, random.uniform(-4, 4, n), 0.6


def message(random, n):
    """A message with every kind of column, and the plan of its columns."""
    states = ObjectStates.of(places(random, n), covariance=covariances(random, n)).columns()
    body = states | {
        "agent": np.zeros(n, np.int64),
        "agents": np.array(["ego"], object),
        "age_ns": np.zeros(1, np.int64),
    }
    return codec.conform(Header("collated", "broker", 0, 0, 0), body), LAYOUTS["collated"].plan((n, 1))


def packed(random, n, m):
    sound, plan = message(random, n)
    body = msgpack.unpackb(codec.encode(sound))["body"]
    name = random.choice(list(body))
    dtype_name, dims, data = body[name]
    wrong = [None, [], "text", ["<f8", dims, data], [dtype_name, [float(n)], data], [dtype_name, [True], data]]
    wrong += [[dtype_name, dims, other] for other in (b"12345678", ["x"], [["x"]])]
    kind = random.integers(0, 2 * len(wrong))
    return (body | {name: wrong[kind]} if kind < len(wrong) else body), plan


def damaged(random, payload, begin):
    """A message with other bytes somewhere after `begin`, cut off, or unchanged."""
    place, kind = int(random.integers(begin, len(payload))), random.integers(0, 4)
    byte = bytes([int(random.choice([0, 65, 127, 128, 160, 190, 192, 255]))])
    return [payload, payload, payload[:place], payload[:place] + byte + payload[place + 1 :]][kind]


def split(random, n, m):
    sound, plan = message(random, n)
    payload, prefix = codec.encode(sound), LAYOUTS["collated"].body_prefix
    begin = payload.index(prefix) + len(prefix)
    return damaged(random, payload, begin), begin, plan


def split_header(random, n, m):
    numbers = [int(random.integers(0, 1 << bits)) for bits in random.choice([6, 7, 8, 16, 32, 62], 3)]
    source = str(random.choice(["", "broker", "x" * 31, "x" * 32, "münchen"]))
    payload = codec.encode(message(random, 1)[0]._replace(header=Header("collated", source, *numbers)))
    prefix = LAYOUTS["collated"].header_prefix
    return damaged(random, payload[: payload.index(b"\xa4body") + 9], 0), prefix


def exact(random, n, m):
    sound, plan = message(random, n)
    body = dict(sound.body)
    name = random.choice(list(body))
    array = body[name]
    wrong = [None, array.tolist(), array[:-1], array.astype(np.float32 if name != "agents" else object), array.copy()]
    wrong += [np.asfortranarray(array), np.repeat(array, 2, axis=0)[::2]]
    kind = random.integers(0, 2 * len(wrong))
    return (body | {name: wrong[kind]} if kind < len(wrong) else body), plan.names, plan.dtypes, plan.shapes


def values(random, n, m):
    sound, plan = message(random, n)
    body = {name: column.copy() for name, column in sound.body.items()}
    if n and random.random() < 0.5:
        name, value = (("position", np.nan), ("covariance", 1e200), ("class_id", 7), ("yaw", -np.inf))[
            random.integers(4)
        ]
        body[name].reshape(-1)[random.integers(body[name].size)] = value
    elif random.random() < 0.5:
        body["agents"][0] = random.choice(np.array(["x" * 257, 7, "y" * 256], object))
    return body, plan.names, tuple(map(limit_of, SCHEMAS[sound.header.schema].columns))


def track_observations(random, n, m):
    tracks = np.zeros((m, following.COLUMNS))
    tracks[:, following.PLACE], tracks[:, following.VELOCITY] = places(random, m), random.normal(0, 9, (m, 3))
    tracks[:, following.UNSEEN], tracks[:, following.AGE] = random.uniform(0, 1, m), random.uniform(0, 2, m)
    tracks[:, following.HITS] = random.integers(1, 5, m)
    tracks[:, following.ID] = random.permutation(2 * m)[:m] - 1 if random.random() < 0.5 else -1
    tracks[:, following.TARGET], tracks[:, following.ROW] = random.integers(-1, 3, m), -1
    id = random.permutation(2 * n)[:n] if random.random() < 0.5 else np.full(n, -1)
    velocity = random.normal(0, 9, (n, 3)) * random.choice([0.0, 1.0], (n, 1))
    return tracks, places(random, n), velocity, id, 0.1, 6.0, following.LIMITS


def buildings(random, m):
    """Start, end, top and first wall of m triangles."""
    corners = random.normal(0, 20, (m, 3, 2))
    end = np.roll(corners, -1, axis=1)
    return corners.reshape(-1, 2), end.reshape(-1, 2), random.uniform(1, 9, 3 * m), 3 * np.arange(m)


def v2x_message(random):
    """The layout of a CPM or CAM, and flat values of one."""
    layout = random.choice([cpm.LAYOUT, cam.LAYOUT])
    maker = MessageMaker(random, random.choice([0.1, 0.5, 0.9]), beyond=True)
    return layout, from_plain(layout, maker.draw(layout.type))


def decoded(random, n, m):
    layout, values = v2x_message(random)
    data = uper.encode(layout, values)
    return layout.program, damaged_message(random, data) if random.random() < 0.8 else data


def encoded(random, n, m):
    layout, values = v2x_message(random)
    for slot in random.integers(0, len(values), random.integers(0, 3)):
        values[slot] = random.choice([-1, 0, 1, 2, 300, 1 << 40, values[slot] + 1])
    return layout.program, values


def point_cells(random, n):
    """Points in whole mm and their cells of 2 m, within 20 m, and the ground of these cells."""
    whole = (1000 * random.uniform(-15, 15, (n, 3)) * random.choice([0.1, 1.0], (n, 1))).astype(np.int32)
    cell = (whole[:, :2] + 20_000) // 2000 @ np.array([20, 1], np.int32)
    return np.column_stack([whole, cell]), random.integers(-3000, 3000, (20, 20)).astype(np.int32), 20_000


def raised_points(random, n, m):
    limits = int(random.integers(1, 4)), 3000, 2000, int(random.choice([300, 5000, 40_000]))
    return *point_cells(random, n), (250, 2500), 350 + 10 * m, int(random.choice([3000, 20_000])), limits


def lowest_points(random, n, m):
    position = np.concatenate([places(random, n), random.uniform(-25, 25, (m, 3)).round(1)]).astype(np.float32)
    position[random.random(n + m) < 0.1] = random.choice(np.array([np.nan, np.inf, -np.inf, 1e30], np.float32))
    return position, 20_000, 5_000, 2_000


def ground_cells(random, n, m):
    lowest = random.integers(-3000, 3000, (n + 1, m + 1)).astype(np.int32)
    lowest[random.random(lowest.shape) < random.choice([0.1, 0.7])] = 1 << 30
    return lowest, random.integers(-500, 500, lowest.shape).astype(np.int32), 120, 20, 100


def clusters_of_points(random, n, m):
    """Points in up to m clusters, and what `fitted_rectangles` needs to know."""
    points, _, _ = point_cells(random, n)
    start = np.unique(np.concatenate([[0, n], random.integers(0, n + 1, m)])).astype(np.int64)
    angles = np.radians(np.arange(0.0, 180.0, 2.0))
    return points, start, np.stack([np.cos(angles), np.sin(angles)], axis=1), 5, 100, 60, 50.0


#: For each kernel its arguments, with n rows and m others (both may be 0).
def scanned(random, n, m):
    """What a scan of n objects and some walls casts, by a lidar that moves."""
    size = random.uniform(0.3, 5.0, (n, 3))
    objects = scan.Moving(
        places(random, n), random.normal(0, 5, (n, 3)), random.uniform(-9, 9, n), random.normal(0, 1, n)
    )
    lidar = scan.Moving(
        random.normal(0, 3, (1, 3)), random.normal(0, 5, (1, 3)), random.normal(0, 2, 1), random.normal(0, 1, 1)
    )
    turn = np.radians(random.choice([90.0, 360.0]))
    azimuth = np.linspace(-turn / 2, turn / 2, 40, endpoint=False)
    beams = Beams(azimuth, np.linspace(-0.5, 0.3, 1 + m), random.normal(0, 0.05, 1 + m), 0.02 * azimuth, 0.0, 60.0)
    walls = Walls.of_buildings((random.normal(0, 20, (4, 2)),), np.array([5.0]))
    mount, arguments = rotation_from_yaw_pitch(0.1, random.choice([0.0, 0.4])), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan, "nearest_surfaces", lambda *given: arguments.extend(given) or (None, None, None))
        scan.cast(beams, lidar, mount, objects, Parts.of(random.integers(0, 7, n), size), -2.0, walls)
    return tuple(arguments)


def echoed(random, n, m):
    """Beams that meet n objects, the ground or nothing."""
    source = random.integers(-3, n, (m, 9)).astype(np.int32)
    range_m = np.where(source == scan.NOTHING, np.inf, random.uniform(0, 99, source.shape))
    return range_m, source, random.random(source.shape), random.random(n + 3).astype(np.float32), 0.9, 0.2


def received(random, n, m):
    """Echoes that are measured by a lidar with 9 channels."""
    range_m, source, power, *_ = echoed(random, n, m)
    echoes = returns.Echoes(range_m.astype(np.float32), source, (2.0 * power).astype(np.float32))
    noise, least = random.normal(0, 0.02, (2, 4096)).astype(np.float32)
    receiver = returns.Receiver(noise, 1.0 + least, 0.01, 3.0, 90.0)
    shapes = (m, 3), (m, 3, 3), (3, 9), (m,)
    firings = returns.Firings(*(random.normal(size=shape).astype(np.float32) for shape in shapes))
    return echoes, random.integers(0, 1 << 64, source.shape, np.uint64), receiver, firings


ARGUMENTS = {
    "lowest_by_cell": lowest_points,
    "ground_surface": ground_cells,
    "clusters_above": raised_points,
    "fitted_rectangles": clusters_of_points,
    "begin_step": lambda r, n, m: (table(r, n), 0.1, 0.09, 30.0, 2.0),
    "predict": lambda r, n, m: (table(r, n), 0.1, covariances(r, 7)),
    "correct": lambda r, n, m: (table(r, n), r.normal(size=(n, k := r.choice([6, 9]))), covariances(r, n, k)),
    "correct_speed": lambda r, n, m: (table(r, n), r.normal(size=(n, 2)), r.uniform(0.1, 9, n)),
    "gate_radius": lambda r, n, m: (table(r, n), covariances(r, m + 1, 6), r.uniform(0, 3, 7), 16.0),
    "pairs_within_radius": lambda r, n, m: (places(r, n), table(r, m), r.integers(0, 9, n).astype(float)),
    "gated_pairs": gated_pairs,
    "nearest_points": lambda r, n, m: (places(r, n), places(r, m)[:, :2], r.integers(0, m + 1, n), r.uniform(0, 9)),
    "useful_pairs": lambda r, n, m: (*(ends := pairs(r, n, m)), r.integers(-4, 3, len(ends[0])).astype(float)),
    "common_tracks": lambda r, n, m: (
        r.choice([0.4, 3.0]) * r.normal(size=(3, n, 2)), np.sort(r.integers(0, m + 1, n)), 0.8,
    ),
    "pair_equations": lambda r, n, m: (
        r.integers(0, m + 1, n), r.integers(0, m + 1, n), r.normal(size=(n, 2)), covariances(r, n, 2),
        r.normal(size=(n, 2, 4)), r.uniform(0, 1, n), m + 1,
    ),
    "min_cost_matching": lambda r, n, m: (*(ends := pairs(r, n, m)), -r.uniform(0, 4, len(ends[0]))),
    "lateral_constraint": lambda r, n, m: (table(r, n), r.normal(size=(n, 2)), r.uniform(0, 9, 7), 0.5, 0.2, 0.15),
    "new_tracks": new_tracks,
    "matched_tracks": matched_tracks,
    "resolve_headings_and_store": lambda r, n, m: (table(r, n + m), r.permutation(n + m)[:n], table(r, n), 2.0, 5.0),
    "end_stages": lambda r, n, m: (staged(r, n), 1.0, STAGES_S),
    "extremes": lambda r, n, m: (r.choice([r.normal(), np.nan, 0.5], n + 1),),
    "report_columns": lambda r, n, m: (staged(r, n), r.uniform(0, 1, n), 0.5),
    "next_table": lambda r, n, m: (table(r, n), r.random(n) < 0.8, r.random(n) < 0.8, table(r, m)),
    "update_missed": lambda r, n, m: (
        table(r, n), r.uniform(0.1, 0.9, n), rows := (r.random(n) < 0.5).nonzero()[0], r.random(len(rows)), 0.03,
    ),
    "coasting_tracks": lambda r, n, m: (table(r, n), 1.0),
    "survival_table": lambda r, n, m: (
        r.random(n).round(2), r.integers(0, 3, n), r.random(n) < 0.6, np.unique(r.random(min(m, 7)).round(1)), 3, 2.0,
    ),
    "calibrated": lambda r, n, m: (
        staged(r, n), STAGES_S, edges := np.unique(r.uniform(0, 1, m).round(1)), r.random((4, len(edges) + 1)),
    ),
    "averaged": averaged,
    "detection_probability": lambda r, n, m: (table(r, n), 0.9, 2.0),
    "track_status": lambda r, n, m: (table(r, n), 19.0, 1.0, 0.0015, 3.0, 9.0, 6.0, 2.0),
    "visible_fraction": view,
    "free_ranges": swept,
    "box_visibility": box_visibility,
    "has_returns": looked_for,
    "lidar_points": cast,
    "outside_view": outside_view,
    "passed_beside": passed_beside,
    "ray_evidence": ray_evidence,
    "median_boxes": median_boxes,
    "weighted_medians": weighted_medians,
    "rotation_from_quaternion": lambda r, n, m: (r.normal(size=(4,) if n == 1 else (n, 4)),),
    "quaternion_from_rotation": lambda r, n, m: (np.linalg.qr(r.normal(size=(n, 3, 3)))[0],),
    "overlap": overlap,
    "constant_velocity": lambda r, n, m: (places(r, n), places(r, n), covariances(r, n), 0.1),
    "rigid_transform": lambda r, n, m: (
        places(r, n), r.uniform(-9, 9, n), covariances(r, n, 3), r.normal(size=3), r.random((3, 3)),
    ),
    "ordered_boxes": ordered_boxes,
    "sorted_rows": lambda r, n, m: (
        tuple(r.integers(0, r.choice([9, 10**6]), n).astype(kind) for kind in r.permutation(
            [np.int64, np.float64, np.uint8])[: r.integers(1, 3)]),
    ),
    "pairs_in_groups": lambda r, n, m: (
        r.integers(0, 3, n + 1), places(r, n + 1), r.integers(0, 4, m + 1), places(r, m + 1), r.uniform(0, 5),
    ),
    "symmetrise": lambda r, n, m: (covariances(r, n) - r.choice([0.0, 0.3]) * np.eye(9), 1e-4, r.choice([1.0, 1e8])),
    "covariance_intersection": lambda r, n, m: (
        covariances(r, n + 1), r.normal(size=(n + 1, 9)), r.uniform(0.1, 1, n + 1), clusters(r, n + 1),
    ),
    "fused_attributes": lambda r, n, m: (
        r.uniform(-4, 4, n + 1), r.integers(0, 9, n + 1).astype(np.uint8), r.random(n + 1), r.uniform(0.1, 1, n + 1),
        clusters(r, n + 1),
    ),
    "merge_pairs": lambda r, n, m: near_pairs(r, n),
    "isolated_groups": tracks_of_agents,
    "merge_nearest": scattered_tracks,
    "achievable": lambda r, n, m: (
        covariances(r, n) - r.choice([0.0, 0.02]) * np.eye(9), np.ones((9, 9)), r.choice([1e-4, 0.2]),
        r.choice([9.0, 1e8]),
    ),
    "horizontal_motion": lambda r, n, m: (
        places(r, n), places(r, n), covariances(r, n), r.integers(0, n, m) if n else np.zeros(0, np.int64),
    ),
    "compare_members": lambda r, n, m: cluster_tracks(r, n),
    "decay_and_add": lambda r, n, m: (
        r.uniform(0, 60, (n + m, n + m, 2, 4)), r.uniform(0, 60, (n, n, 2, 4)), 0.9, 0.2, r.choice([1.0, 9.0]), 10.0,
    ),
    "track_observations": track_observations,
    "imitate_rows": lambda r, n, m: (
        (places(r, m), r.normal(0, 9, (m, 3)), r.uniform(0.3, 5, (m, 3)), r.uniform(-4, 4, m)),
        r.normal(size=(m, 11)), r.uniform(0, 90, m),
        (places(r, n + 1), covariances(r, n + 1) * r.choice([0, 1, 9], (n + 1, 1, 1)), r.random(n + 1), r.random(3)),
        (0.3, 0.1, 0.05), bool(r.integers(2)), (3.0, 0.3),
    ),
    "occluded_by_walls": lambda r, n, m: (r.normal(0, 9, 3), r.normal(0, 20, (n, 3)), *buildings(r, m)[:3]),
    "inside_outlines": lambda r, n, m: (r.normal(0, 20, (n, 3)), *(walls := buildings(r, m))[:2], walls[3]),
    "nearest_surfaces": scanned,
    "surface_echoes": echoed,
    "measured_points": received,
    "packed_columns": packed,
    "split_columns": split,
    "split_header": split_header,
    "exact_columns": exact,
    "sound_values": values,
    "decode_values": decoded,
    "encode_values": encoded,
}  # fmt: skip


def assert_same(one, other):
    """Assert equality within 1e-9, exact for non-floats."""
    assert type(one) is type(other) or isinstance(one, bool | np.bool_ | float | np.floating)
    if isinstance(one, tuple | list):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif dataclasses.is_dataclass(one):
        assert_same(dataclasses.astuple(one), dataclasses.astuple(other))
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            assert_same(one[name], other[name])
    elif isinstance(one, np.ndarray) and one.dtype != object:
        assert (one.dtype, one.shape, one.flags.writeable) == (other.dtype, other.shape, other.flags.writeable)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)
    elif isinstance(one, float):
        np.testing.assert_allclose(one, other, rtol=1e-9)
    else:
        assert np.all(one == other)


def test_every_kernel_is_compared_with_its_reference():
    assert ARGUMENTS.keys() == kernels.REFERENCES.keys()
    if kernels.COMPILED:
        assert ARGUMENTS.keys() <= kernels.COMPILED.keys()


def reference_of(name):
    """What a kernel is compared with: its version in Python, which for the codec of V2X messages is in the tests."""
    return getattr(uper_oracle, name, kernels.REFERENCES[name])


@compiled
@pytest.mark.parametrize("name", sorted(ARGUMENTS))
@given(st.integers(0, 2**32), st.sampled_from([0, 1, 2, 3, 9, 30]), st.sampled_from([0, 1, 2, 8, 25]))
def test_a_compiled_kernel_equals_its_numpy_reference(name, seed, n, m):
    arguments = ARGUMENTS[name](np.random.default_rng(seed), n, m)
    ours, reference = copy.deepcopy(arguments), copy.deepcopy(arguments)
    with np.errstate(all="ignore"):
        expected = reference_of(name)(*reference)
    assert_same(kernels.COMPILED[name](*ours), expected)
    assert_same(ours, reference)  # arrays changed in place


@compiled
def test_a_node_with_compiled_kernels_does_not_import_scipy():
    """SciPy takes as long to load as everything else that a node needs."""
    code = "import nodes.agent, nodes.command_center, nodes.simulator, nodes.adversary, sys; print(*sys.modules)"
    root = Path(mast_zenoh.__file__).parents[1]
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert "nodes.agent" in process.stdout.split()
    assert "scipy" not in process.stdout.split()


PLAY = """
import sys
import numpy as np
from mast_zenoh import kernels, scenario
from mast_zenoh.mesh.inproc import InProcess
path, loaded = scenario.load("coordinated", [f"scene={sys.argv[1]}"])
heard = {}
def tap(sent):
    if "tracks" in sent.key or "picture" in sent.key or "mission" in sent.key:
        for name, column in sent.payload.body.items():
            heard.setdefault(f"{sent.key} {name}", []).append(column)
InProcess(scenario.resolve(path, loaded), tap=tap).run()
np.savez(sys.argv[2], kernels=kernels.USED, **{name: np.concatenate(parts) for name, parts in heard.items()})
"""


def played(scene: str, mode: str, file: Path):
    """Tracks and pictures of a whole run with one kind of kernels."""
    command = [sys.executable, "-c", PLAY, scene, str(file)]
    subprocess.run(command, env=os.environ | {"MAST_KERNELS": mode}, check=True)
    return np.load(file)


@pytest.mark.heavy
@compiled
def test_a_recorded_scene_has_the_same_tracks_with_compiled_and_numpy_kernels(tmp_path):
    scene = "intersection"
    if (DATA / "scene_a.tar.gz").is_file():
        with tarfile.open(DATA / "scene_a.tar.gz") as archive:
            archive.extractall(tmp_path, filter="data")
        scene = f"avstack:{tmp_path}/scene_a"
    ours, numpy = (played(scene, mode, tmp_path / f"{mode}.npz") for mode in ("compiled", "numpy"))
    assert (str(ours["kernels"]), str(numpy["kernels"])) == ("compiled", "numpy")
    assert ours.files == numpy.files
    assert any(name.endswith("picture id") for name in ours.files)
    for name in set(ours.files) - {"kernels"}:
        if name.endswith("yaw"):  # half a turn in either direction is equal
            np.testing.assert_allclose(np.exp(1j * ours[name]), np.exp(1j * numpy[name]), atol=1e-9)
        else:
            np.testing.assert_allclose(ours[name], numpy[name], rtol=1e-9, atol=1e-9, err_msg=name)


def used(code: str, mode: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", f"{code}; from mast_zenoh import kernels; print(kernels.USED)"]
    return subprocess.run(command, env=os.environ | {"MAST_KERNELS": mode}, capture_output=True, text=True, check=False)


@compiled
def test_kernels_compiled_from_other_sources_are_not_used(tmp_path):
    copied = tmp_path / "mast_zenoh"
    shutil.copytree(Path(mast_zenoh.__file__).parent, copied)
    here = f"import sys; sys.path.insert(0, {str(tmp_path)!r})"
    assert used(here, "").stdout.strip() == "compiled"
    with (copied / "kernels" / "tracks.pyx").open("a") as source:
        source.write("# changed")
    assert used(here, "").stdout.strip() == "numpy"


@pytest.mark.parametrize(("mode", "message"), [("fast", "numpy or compiled"), ("compiled", "none were built")])
def test_unavailable_or_unknown_kernels_are_refused(mode, message):
    hidden = "import sys; sys.modules['mast_zenoh.kernels.tracks'] = None"
    assert message in used(hidden, mode).stderr


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        ({}, "without compiling them"),
        ({"not_compiled.txt": "there is no C compiler (install gcc): command 'cc' failed"}, "no C compiler"),
        ({f"attacks{EXTENSION_SUFFIXES[0]}": ""}, r"sources.*changed"),
        ({"attacks.cpython-27-pdp11-unix.so": ""}, r"another Python \(attacks.cpython-27-pdp11-unix.so\)"),
    ],
    ids=["never compiled", "a failed build", "old sources", "another Python"],
)
def test_the_reason_why_no_kernels_are_compiled_is_known(monkeypatch, tmp_path, files, reason):
    monkeypatch.setattr(kernels, "USED", "numpy")
    monkeypatch.setattr(kernels, "COMPILED", {})
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    assert re.search(reason, kernels.why_not(tmp_path))
    monkeypatch.setattr(kernels, "COMPILED", {"predict": print})
    assert "MAST_KERNELS" in kernels.why_not(tmp_path)
    monkeypatch.setattr(kernels, "USED", "compiled")
    assert kernels.why_not(tmp_path) == ""


@pytest.mark.parametrize(
    ("place", "size", "turn"),
    [
        ((np.nan, 0.0, 0.0), (2.0, 2.0, 2.0), 1.0),
        ((10.0, 0.0, 0.0), (np.inf, 2.0, 2.0), 1.0),
        ((10.0, 0.0, 0.0), (2.0, 2.0, 2.0), np.nan),
        ((1.0, 0.0, 0.0), (2.0, 2.0, 2.0), 1.0),  # the lidar is on its face
    ],
)
def test_returns_of_boxes_that_are_not_finite_or_touch_the_lidar_are_those_of_the_reference(place, size, turn) -> None:
    boxes = np.array([place, (20.0, 1.0, 0.0)]), np.array([size, (4.0, 2.0, 2.0)]), np.zeros(2)
    arguments = LidarSensor(azimuth_step_deg=1.0), np.zeros(3), np.eye(3) * turn, *boxes
    with np.errstate(invalid="ignore"):
        expected = kernels.REFERENCES["lidar_points"](*arguments)
        np.testing.assert_array_equal(lidar_points(*arguments), expected)


def test_boxes_without_sizes_are_refused_by_kernel_and_reference() -> None:
    arguments = LidarSensor(), np.zeros(3), np.eye(3), np.zeros((2, 3)), np.ones((1, 3)), np.zeros(2)
    for cast_all in (lidar_points, kernels.REFERENCES["lidar_points"]):
        with pytest.raises((IndexError, ValueError)):
            cast_all(*arguments)
