"""A finished run as one block of bytes: everything that the page that plays it shows.

The block holds a header (JSON) and columns of integers (`columns`). Rows of boxes that belong to one object follow each
other, so that neighbours differ little. `docs/viewer.md` describes the content.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow

from mast_zenoh.arrays.states import CLASSES, Floats
from mast_zenoh.report.figures.style import STATES
from mast_zenoh.report.files import column, rows
from mast_zenoh.report.playback.boxes import ANGLE, LENGTH, SCORE, BoxTable, no_boxes, read_boxes
from mast_zenoh.report.playback.columns import Packer
from mast_zenoh.report.playback.conduct import add_agent_states, add_manipulations, add_withheld, spans
from mast_zenoh.report.playback.events import events
from mast_zenoh.report.playback.motion import Motion, recorded_motion
from mast_zenoh.report.playback.surroundings import add_surroundings
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.scores import ESTIMATES
from mast_zenoh.viewer.palette import ADVERSARY, OUTCOME_COLOURS

FORMAT = 1
#: m/s, m and 1: resolution of velocities, of standard deviations and of correlations.
_SPEED, _SPREAD, _CORRELATION = 0.05, 0.02, 0.02
#: Damage to objects.parquet, which the report names among its missing files.
_DAMAGE = (OSError, ValueError, KeyError, pyarrow.ArrowException)


def run_block(run: RunFolder, frame: int | None = None, label: str = "") -> bytes | None:
    """The block of a run; None if it has nothing to show: neither boxes nor a scene.

    frame: the frame to show first; None: the first of the run
    label: the name that the page gives it; empty: its own
    Raises ValueError if a number is too large for the block.
    """
    try:
        boxes = read_boxes(run.path / "objects.parquet", run.recording)
    except _DAMAGE:
        boxes = no_boxes(run.recording)
    if not len(boxes.frame):
        return None
    frames = int(boxes.frame.max()) + 1
    if frame is not None and frame >= frames:
        raise ValueError(f"found frame {frame}, expected one of 0 to {frames - 1}")
    times = _times(run, frames)
    packer = Packer()
    packer.add("time", times, scale=1e-3)
    header = {
        **pack_frames(packer, run, boxes, recorded_motion(boxes, run.path, run.recording), times),
        "label": label or run.label,
        "folder": run.path.name,
        "frame": frame if frame is not None else 0,
        "recorded": (run.path / "messages.mcap").is_file(),
        "spans": spans(run, times),
    }
    header["events"] = events(run, boxes, header["spans"], times)
    return packer.block(header)


def pack_frames(packer: Packer, run: RunFolder, boxes: BoxTable, motion: Motion, times: Floats) -> dict[str, Any]:
    """Add all columns of (f,) frames but their times, and return the part of the header that describes them.

    run: in which the frames are 0 to f - 1;  times: (f,) s
    """
    frames = len(times)
    header: dict[str, Any] = {
        "format": FORMAT,
        "id": str(run.run.get("id", "")),
        "frames": frames,
        "ego": run.ego or "",
        "scored": run.scored_frames,
        "gate_m": run.gate_m,
        "range_m": run.range_m,
        "classes": CLASSES,
        "colours": {"outcomes": OUTCOME_COLOURS, "adversary": ADVERSARY, "states": STATES},
    }
    header |= _add_boxes(packer, run, boxes, motion)
    header |= add_surroundings(packer, run, frames)
    names = [agent["name"] for agent in header["agents"]]
    header |= add_agent_states(packer, run, names, times)
    header |= add_manipulations(packer, run)
    add_withheld(packer, run)
    header["series"] = _add_series(packer, run, frames)
    return header


def _times(run: RunFolder, frames: int) -> Floats:
    seconds = run.seconds(np.arange(frames))
    return np.asarray(np.arange(frames) * run.period_s, np.float64) if seconds is None else seconds


def _add_boxes(packer: Packer, run: RunFolder, boxes: BoxTable, motion: Motion) -> dict[str, Any]:
    """Add the columns of boxes and of their meaning in each view, and return `views` and `meanings`."""
    packer.add("box.frame", boxes.frame)
    packer.add("box.id", boxes.id)
    packer.add("box.truth", boxes.truth, differences=False)
    for index, name in enumerate("xyzlwh"):
        packer.add(f"box.{name}", boxes.geometry[:, index], scale=LENGTH)
    packer.add("box.yaw", boxes.geometry[:, 6], scale=ANGLE)
    packer.add("box.score", boxes.score, scale=SCORE)
    packer.add("box.known", motion.known, differences=False)
    for index, name in enumerate(("vx", "vy")):
        packer.add(f"box.{name}", motion.velocity[:, index], scale=_SPEED)
    for index, (name, scale) in enumerate({"sx": _SPREAD, "sy": _SPREAD, "rho": _CORRELATION}.items()):
        packer.add(f"box.{name}", motion.spread[:, index], scale=scale)
    packer.add("box.kind", motion.kind, differences=False)
    packer.add("code", boxes.codes, differences=False)
    packer.add("match", boxes.matches[boxes.matches >= 0])
    packer.add("matched", boxes.matches >= 0, differences=False)
    own = [{"agent": view.agent, "estimate": view.estimate, "row": i} for i, view in enumerate(boxes.views)]
    rows_by_view = {tuple(view): i for i, view in enumerate(boxes.views)}
    same = [
        {"agent": agent, "estimate": estimate, "row": rows_by_view[agent, original]}
        for agent, pairs in run.metrics.get("same_as", {}).items()
        for estimate, original in pairs.items()
        if (agent, original) in rows_by_view and (agent, estimate) not in rows_by_view
    ]
    order = list(ESTIMATES)
    known = [view for view in own + same if view["estimate"] in order]
    known.sort(key=lambda view: (view["agent"], order.index(view["estimate"])))
    return {
        "views": known,
        "estimates": ESTIMATES,
        "meanings": [list(each) for each in boxes.meanings],
    }


def _add_series(packer: Packer, run: RunFolder, frames: int) -> list[dict[str, str]]:
    """Add `series.*`, a row per frame of each estimate in metrics.parquet, and return which they are.

    RMSE is -1 where there is no matched pair.
    """
    if run.counts is None:
        return []
    table = run.counts
    table = rows(table, table["frame"] < frames)
    of_rows = list(zip(table["agent"].tolist(), table["estimator"].tolist(), strict=True))
    pairs = sorted(set(of_rows))
    number = {pair: index for index, pair in enumerate(pairs)}
    series = np.array([number[pair] for pair in of_rows], np.int64)
    for name in ("fn", "fp", "tp", "rmse_m"):
        values = np.full((len(pairs), frames), -1.0)
        values[series, table["frame"].astype(np.int64)] = np.nan_to_num(column(table, name), nan=-1.0)
        packer.add(f"series.{name}", values, scale=0.001 if name == "rmse_m" else 1.0)
    return [{"agent": agent, "estimate": estimate} for agent, estimate in pairs]
