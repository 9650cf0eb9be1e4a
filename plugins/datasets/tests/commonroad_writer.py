"""Writes a recording as a CommonRoad scenario, version 2020a or 2018b."""

from pathlib import Path

import numpy as np

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.scenes.recording import Recording


def write_commonroad(recording: Recording, path: Path, version: str = "2020a") -> Path:
    """Write every object as a dynamic obstacle, and every building as an environment obstacle."""
    step = recording.period_ns / 1e9
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<commonRoad timeStepSize="{step}" commonRoadVersion="{version}" benchmarkID="TWIN-1_1_T-1" author="twin">',
        '<lanelet id="1"><leftBound><point><x>0</x><y>0</y></point></leftBound></lanelet>',
    ]
    frame = np.repeat(np.arange(len(recording)), np.diff(recording.truth_start))
    for number in np.unique(recording.truth.id):
        rows = np.flatnonzero(recording.truth.id == number)
        lines += obstacle(recording, int(number), rows, frame[rows], version)
    if version == "2020a":
        for index, outline in enumerate(recording.buildings):
            points = "".join(f"<point><x>{x!r}</x><y>{y!r}</y></point>" for x, y in outline.tolist())
            shape = f"<shape><polygon>{points}</polygon></shape>"
            described = f'<environmentObstacle id="{900_000 + index}"><type>building</type>{shape}'
            lines.append(f"{described}</environmentObstacle>")
    end = '<planningProblem id="999999"><initialState/></planningProblem></commonRoad>'
    path.write_text("\n".join([*lines, end]))
    return path


def obstacle(recording: Recording, number: int, rows: np.ndarray, frame: np.ndarray, version: str) -> list[str]:
    truth = recording.truth
    length, width, _ = truth.size[rows[0]].tolist()
    tag = "dynamicObstacle" if version == "2020a" else "obstacle"
    role = "<role>dynamic</role>" if version == "2018b" else ""
    lines = [f'<{tag} id="{number}">{role}<type>{CLASSES[truth.class_id[rows[0]]]}</type>']
    lines.append(f"<shape><rectangle><length>{length!r}</length><width>{width!r}</width></rectangle></shape>")
    for index, (row, step) in enumerate(zip(rows, frame, strict=True)):
        if index == 1:
            lines.append("<trajectory>")
        lines += state(recording, int(row), int(step), "initialState" if index == 0 else "state")
    return [*lines, "</trajectory>", f"</{tag}>"]


def state(recording: Recording, row: int, step: int, tag: str) -> list[str]:
    truth = recording.truth
    x, y, _ = truth.position[row].tolist()
    yaw = float(truth.yaw[row])
    vx, vy, _ = truth.velocity[row].tolist()
    ahead, left = vx * np.cos(yaw) + vy * np.sin(yaw), vy * np.cos(yaw) - vx * np.sin(yaw)
    return [
        f"<{tag}>",
        f"<position><point><x>{x!r}</x><y>{y!r}</y></point></position>",
        f"<orientation><exact>{yaw!r}</exact></orientation>",
        f"<time><exact>{step}</exact></time>",
        f"<velocity><exact>{float(ahead)!r}</exact></velocity>",
        f"<velocityY><exact>{float(left)!r}</exact></velocityY>",
        f"</{tag}>",
    ]
