"""Writes a small scene in the CARLA multi-agent layout (nested JSON strings)."""

import json
from pathlib import Path
from typing import Any

import numpy as np

FRAMES = (4, 5, 6, 7)
#: Pole: 15 m up at (30, 10), looking 30 degrees down against x.
POLE = np.array([30.0, 10.0, 15.0])


def passive(yaw: float, pitch_down: float = 0.0) -> tuple[float, list[float]]:
    """Passive quaternion (w, [x, y, z]) of a heading and a pitch."""
    cy, sy, cp, sp = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(pitch_down / 2), np.sin(pitch_down / 2)
    return float(cy * cp), [float(sy * sp), float(-cy * sp), float(-sy * cp)]


def reference(x: list[float], qw: float, qv: list[float], parent: str | None) -> str:
    data = {"x": x, "qw": qw, "qv": qv, "v": [0.0] * 3, "reference": parent, "handedness": "right"}
    return json.dumps({"reference": data})


WORLD = reference([0.0] * 3, 1.0, [0.0] * 3, None)


def vector(name: str, x: list[float]) -> str:
    return json.dumps({name: {"x": x, "reference": WORLD, "n_prec": 8}})


def attitude(qw: float, qv: list[float]) -> str:
    return json.dumps({"attitude": {"qw": qw, "qv": qv, "reference": WORLD}})


def state(kind: str, number: int, x: list[float], yaw: float = 0.0, pitch: float = 0.0, **more: Any) -> dict[str, Any]:
    """An object state with optional velocity, size, position and visibility."""
    turned = passive(yaw, pitch)
    hwl = more.get("hwl", [1.5, 1.8, 4.2])
    box = {"position": vector("position", x), "attitude": attitude(*turned), "hwl": hwl}
    box |= {"where_is_t": more.get("where", "bottom"), "obj_type": kind, "ID": number}
    velocity = more.get("velocity", [1.0, 0.0, 0.0])
    return {
        "obj_type": kind,
        "ID": number,
        "occlusion": more.get("occlusion", 99),
        "t": 0.0,
        "box": None if hwl is None else json.dumps({"box3d": box}),
        "position": vector("position", x),
        "velocity": None if velocity is None else vector("velocity", velocity),
        "attitude": attitude(*turned),
        "visible_fraction": more.get("visible_fraction"),
    }


def write_objects(folder: Path, kind: str, frame: int, states: list[dict[str, Any]], time: float | None = None) -> Path:
    time = frame / 10 if time is None else time
    container = {"frame": frame, "timestamp": time, "source_identifier": kind}
    container["data"] = [json.dumps({"objectstate": entry}) for entry in states]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"objectstate-{kind}-{frame:010d}-{frame / 10:012.2f}.txt"
    path.write_text(json.dumps({"datacontainer": container}))
    return path


def write_calibration(folder: Path, frame: int, agent: str, mount: list[float], camera: bool) -> Path:
    own = (-0.5, [-0.5, 0.5, -0.5]) if camera else (1.0, [0.0] * 3)
    calibration: dict[str, Any] = {"reference": reference(mount, *own, agent)}
    if camera:
        calibration |= {"P": [[400.0, 0, 400.0, 0], [0, 400.0, 300.0, 0], [0, 0, 1.0, 0]], "img_shape": [600, 800, 3]}
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"calib-timestamp_{frame / 10:08.2f}-frame_{frame:06d}.txt"
    path.write_text(json.dumps({"calibration": calibration}))
    return path


def actors_at(frame: int, second_car: bool = False) -> list[dict[str, Any]]:
    """The ego, a pole, and optionally another car with sensors ahead of the ego."""
    return [
        state("car", 0, [0.1 * frame, 0.0, 0.0]),
        state("static-actor", 1, POLE.tolist(), np.pi, np.radians(30), hwl=None, velocity=[0.0] * 3),
        *([state("car", 2, [8.0 + 0.1 * frame, 0.0, 0.0])] if second_car else []),
    ]


def npcs_at(frame: int) -> list[dict[str, Any]]:
    return [
        state("car", 0, [10.4, 3.0 + 0.2 * frame, 0.0], np.pi / 2, velocity=[0.0, 2.0, 0.0]),
        state("truck", 1, [20.0, -3.6, 1.5], hwl=[3.0, 2.5, 8.0], where="center", velocity=[0.0] * 3),
    ]


def write_run(run: Path, second_car: bool = False) -> Path:
    """Frames 4 to 7: an ego passes a car and a truck; a pole partly sees the car."""
    for frame in FRAMES:
        write_objects(run / "objects", "actors", frame, actors_at(frame, second_car))
        write_objects(run / "objects", "npcs", frame, npcs_at(frame))
        both, part = npcs_at(frame), npcs_at(frame)[:1]
        part[0]["visible_fraction"] = 0.5
        write_objects(run / "objects_sensor" / "lidar-0-0", "objects", frame, both)
        write_objects(run / "objects_sensor" / "lidar-0-1", "objects", frame, part)
        ego = reference([0.1 * frame, 0.0, 0.0], 1.0, [0.0] * 3, WORLD)
        pole = reference(POLE.tolist(), *passive(np.pi, np.radians(30)), WORLD)
        sensors = [(0, ego, [0.0, 0.0, 1.8]), (1, pole, [0.0] * 3)]
        if second_car:
            sensors.append((2, reference([8.0 + 0.1 * frame, 0.0, 0.0], 1.0, [0.0] * 3, WORLD), [0.0, 0.0, 1.8]))
        for number, agent, mount in sensors:
            write_calibration(run / "data" / f"lidar-0-{number}", frame, agent, mount, camera=False)
            write_calibration(run / "data" / f"camera-0-{number}", frame, agent, mount, camera=True)
    return run


def write_lines(path: Path, entries: list[dict[str, Any]]) -> Path:
    path.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    return path
