"""Writes a recording as floating-car data of SUMO, with vehicle types and polygons."""

from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.scenes.recording import Recording

VEHICLE_CLASS = {"car": "passenger", "unknown": "custom1"}


def write_sumo(recording: Recording, folder: Path, kind: str = "xml") -> Path:
    """Write fcd.xml or fcd.csv, types.add.xml and houses.poly.xml, as SUMO and its tools write them."""
    folder.mkdir(parents=True, exist_ok=True)
    truth = recording.truth
    size, number = np.unique(np.column_stack([truth.size, truth.class_id]), axis=0, return_inverse=True)
    (folder / "types.add.xml").write_text("\n".join(["<additional>", *map(vehicle_type, range(len(size)), size)]) + END)
    steps = []
    for frame in range(len(recording)):
        start, end = recording.truth_start[frame : frame + 2]
        steps.append([road_user(recording, row, int(number[row])) for row in range(start, end)])
    (folder / f"fcd.{kind}").write_text({"xml": as_xml, "csv": as_csv}[kind](recording, steps))
    polygons = [polygon(*part) for part in enumerate(zip(recording.buildings, recording.building_height, strict=True))]
    (folder / "houses.poly.xml").write_text("\n".join(["<additional>", *polygons]) + END)
    return folder


END = "\n</additional>\n"


def vehicle_type(number: int, row: np.ndarray) -> str:
    length, width, height, class_id = row.tolist()
    name = CLASSES[int(class_id)]
    size = f'length="{length}" width="{width}" height="{height}"'
    return f'<vType id="type{number}" vClass="{VEHICLE_CLASS.get(name, name)}" {size}/>'


def road_user(recording: Recording, row: int, kind: int) -> tuple[bool, dict[str, Any]]:
    """Whether it is a person, and its attributes; the position is that of the front bumper."""
    truth = recording.truth
    person = CLASSES[truth.class_id[row]] == "pedestrian"
    yaw = float(truth.yaw[row])
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    x, y = (truth.position[row, :2] + (0.0 if person else truth.size[row, 0] / 2) * ahead).tolist()
    angle, speed = float((90.0 - np.degrees(yaw)) % 360.0), float(truth.velocity[row, :2] @ ahead)
    return person, dict(id=f"user.{truth.id[row]}", x=x, y=y, angle=angle, type=f"type{kind}", speed=speed)


def as_xml(recording: Recording, steps: list[list[tuple[bool, dict[str, Any]]]]) -> str:
    lines = ["<?xml version='1.0'?>", "<!-- a comment -->", "<fcd-export>"]
    for time, users in zip(recording.times_ns, steps, strict=True):
        lines.append(f'    <timestep time="{time / 1e9:.2f}">')
        for person, values in users:
            attributes = " ".join(f'{name}="{value}"' for name, value in values.items())
            lines.append(f"        <{'person' if person else 'vehicle'} {attributes}/>")
        lines.append("    </timestep>")
    return "\n".join([*lines, "</fcd-export>", ""])


def as_csv(recording: Recording, steps: list[list[tuple[bool, dict[str, Any]]]]) -> str:
    names = list(steps[0][0][1])
    lines = [";".join(["timestep_time", *(f"{kind}_{name}" for kind in ("vehicle", "person") for name in names)])]
    for time, users in zip(recording.times_ns, steps, strict=True):
        for person, values in users:
            text, empty = [str(value) for value in values.values()], [""] * len(names)
            lines.append(";".join([f"{time / 1e9:.2f}", *(empty + text if person else text + empty)]))
    return "\n".join([*lines, ""])


def polygon(number: int, part: tuple[np.ndarray, float]) -> str:
    outline, height = part
    shape = " ".join(f"{x},{y}" for x, y in [*outline.tolist(), outline[0].tolist()])
    return f'<poly id="{number}" type="building.house" shape="{shape}"><param key="height" value="{height} m"/></poly>'
