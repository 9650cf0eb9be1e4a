"""Consequences of the estimates for driving: table rows, and a chart over time."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from mast_zenoh.report.figures.bands import bands, shade
from mast_zenoh.report.figures.style import ADVERSARY_ON_LIGHT, INK, LOCAL, RUN_COLOURS, Figure, light_axes
from mast_zenoh.report.figures.timeaxis import padded, rows_over_time
from mast_zenoh.report.files import Table, rows
from mast_zenoh.report.narrative.changes import scored
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.scores import DASH

#: Estimates by which a vehicle might drive, and their names.
ESTIMATES = {"truth": "truth", "local": "ego alone", "mission": "ego with picture"}
_COLOURS = {"truth": INK, "local": LOCAL, "mission": RUN_COLOURS[1]}
_STYLES = {"truth": (0, (4, 2)), "local": (0, (1, 1)), "mission": "-"}
#: s, the largest time to collision in the chart.
_MAX_TTC_S = 10.0
#: Colour and label of braking decisions by estimate and truth.
_BRAKING = {
    "brake": ("#9aa3ad", "brakes, as by the truth"),
    "needless": ("#d62839", "brakes needlessly"),
    "omitted": ("#e0a800", "does not brake where it must"),
}

_WRONG_BRAKING = {"needless_brake_share": "brakes needlessly", "missed_brake_share": "does not brake where it must"}
#: A smaller share of the frames is printed as none.
_MIN_SHARE = 0.0005


class DrivingRow(NamedTuple):
    """Driving metrics of an estimate; in brackets the change over a reference.

    run: label of the run
    false, missed: objects per frame in the vehicle's corridor;  overlapping: those that overlap the vehicle itself
    ttc_s: minimum time to collision, s
    brake: share of the frames with braking;  needless, omitted: share with needless and with omitted braking, with the
           part due to attacks, and the unattributed increase over the reference
    """

    estimate: str
    run: str
    objects: str
    false: str
    missed: str
    overlapping: str
    ttc_s: str
    brake: str
    needless: str
    omitted: str


def driving_rows(run: RunFolder, reference: RunFolder | None = None, name: str = "") -> list[DrivingRow]:
    """Rows for the truth, the ego alone and the ego with the picture.

    Empty if the ego is not a vehicle.
    reference: the run that this one is compared with, labelled `name`; it gets a row per estimate as well
    """
    own, references = _summaries(run), _summaries(reference)
    result = []
    for estimate, label in ESTIMATES.items():
        if estimate in own and estimate in references:
            result.append(_row(label, name, references[estimate], {}, name))
        if estimate in own:
            result.append(_row(label, run.label, own[estimate], references.get(estimate, {}), name))
    return result


def driving_differs(run: RunFolder, reference: RunFolder) -> bool:
    """Whether the ego's driving metrics differ between two runs."""
    own, references = _summaries(run), _summaries(reference)
    return bool(own and references) and own != references


def _summaries(run: RunFolder | None) -> dict[str, dict[str, Any]]:
    """The ego's driving metrics by estimate."""
    if run is None:
        return {}
    summaries: dict[str, dict[str, Any]] = run.metrics.get("driving", {}).get(run.ego or "", {})
    return summaries


def _unattributed(each: dict[str, Any], other: dict[str, Any], key: str) -> float:
    """Unattributed increase of a share of frames over another run; 0: none."""
    share, reference_share = each.get(key), other.get(key)
    if share is None or reference_share is None:
        return 0.0
    attack = (each.get(f"{key}_attack") or 0.0) - (other.get(f"{key}_attack") or 0.0)
    more = float(share - reference_share - max(attack, 0.0))
    return more if more >= _MIN_SHARE else 0.0


def _row(name: str, run: str, each: dict[str, Any], other: dict[str, Any], reference: str) -> DrivingRow:
    def text(key: str, digits: int, scale: float = 1.0, nothing: str = DASH) -> str:
        value, before = each.get(key), other.get(key)
        unit = "%" if scale != 1.0 else ""
        if value is None:
            return nothing
        number = f"{scale * value:.{digits}f}{unit}"
        if before is None:
            return number
        change = round(scale * (value - before), digits) + 0.0  # not a negative zero
        return f"{number} ({change:+.{digits}f})".replace("-", "\u2212")

    def share(key: str) -> str:
        attack, more = each.get(f"{key}_attack"), _unattributed(each, other, key)
        notes = [f"{attack:.1%} by attack"] if attack else []
        notes += [f"{more:.1%} more than {reference}, not attributed"] if more else []
        return text(key, 1, 100.0) + (f" ({'; '.join(notes)})" if notes else "")

    return DrivingRow(
        name,
        run,
        text("corridor_objects", 2),
        text("corridor_false", 2),
        text("corridor_missed", 2),
        text("overlapping_objects", 2),
        text("min_ttc_s", 1, nothing="never"),
        text("brake_share", 1, 100.0),
        share("needless_brake_share"),
        share("missed_brake_share"),
    )


def braking_by_attack(run: RunFolder) -> str:
    """Wrong braking of the ego with picture by attacks, in words; empty: none."""
    mission = _summaries(run).get("mission", {})
    return _braking({words: mission.get(f"{key}_attack") for key, words in _WRONG_BRAKING.items()})


def unattributed_braking(run: RunFolder, reference: RunFolder, name: str) -> str:
    """Unattributed increase of wrong braking over a run, in words; empty: none."""
    own, other = (_summaries(each).get("mission", {}) for each in (run, reference))
    braking = _braking({words: _unattributed(own, other, key) for key, words in _WRONG_BRAKING.items()})
    return f"{braking} more than {name}, not attributed" if braking else ""


def _braking(shares: dict[str, float | None]) -> str:
    parts = [f"{words} in {share:.1%} of the scored frames" for words, share in shares.items() if share]
    return f"the ego with the picture {' and '.join(parts)}" if parts else ""


def driving_over_time(run: RunFolder, frame: int | None) -> Figure | None:
    """Time to collision, wrong objects and braking over time; None: not a vehicle."""
    if run.driving is None or not np.any(run.driving["agent"] == run.ego):
        return None
    ego_rows = rows(run.driving, run.driving["agent"] == run.ego)
    parts = {
        name: rows(ego_rows, ego_rows["estimate"] == name) for name in ESTIMATES if np.any(ego_rows["estimate"] == name)
    }
    frames = parts[next(iter(parts))]["frame"].astype(np.int64)
    seconds = run.seconds(frames)
    times = frames.astype(np.float64) if seconds is None else seconds
    marked = bands([run], timed=seconds is not None)
    extent = float(times[0]), float(times[-1])
    figure, axes = rows_over_time(3, 1.5, marked, *extent)
    for axis in axes:
        light_axes(axis)
        shade(axis, marked, *extent, hatch=False)
        axis.set_xlim(*padded(*extent))
        if frame is not None:
            axis.axvline(float(np.interp(frame, frames, times)), color=INK, linewidth=0.9)
        if run.attack_frames is not None:
            first, last = np.interp(run.attack_frames, frames, times)
            axis.axvspan(float(first), float(last), color=ADVERSARY_ON_LIGHT, alpha=0.07, linewidth=0)
    _draw_collision(axes[0], times, parts)
    _draw_corridor(axes[1], times, parts, scored(run, frames))
    _draw_braking(axes[2], times, parts)
    axes[-1].set_xlabel("frame" if seconds is None else "time (s)", fontsize=10, color=INK)
    handles: dict[str, Any] = {}
    for axis in axes:
        handles |= {label: handle for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="upper left",
        bbox_to_anchor=(0.055, 1.0),
        ncols=8,
        frameon=False,
        fontsize=9,
        columnspacing=1.0,
        handlelength=1.6,
    )
    return figure


def _draw_collision(axis: Axes, times: np.ndarray, parts: dict[str, Table]) -> None:
    for name, part in parts.items():
        ttc = np.nan_to_num(part["ttc_s"].astype(np.float64), nan=np.inf)
        visible = np.where(ttc <= _MAX_TTC_S, ttc, np.nan)
        axis.plot(
            times,
            visible,
            color=_COLOURS[name],
            linestyle=_STYLES[name],
            linewidth=1.8,
            marker=".",
            markersize=3,
            label=ESTIMATES[name],
        )
    if not any((part["ttc_s"].astype(np.float64) <= _MAX_TTC_S).any() for part in parts.values()):
        _annotate(axis, f"nothing in the way within {_MAX_TTC_S:.0f} s, by any of the three")
    axis.set_ylim(0.0, _MAX_TTC_S)
    axis.set_ylabel("time to\ncollision (s)", fontsize=10, color=INK)


def _draw_corridor(axis: Axes, times: np.ndarray, parts: dict[str, Table], in_scored_frames: np.ndarray) -> None:
    maximum = 1.0
    for name, part in parts.items():
        wrong = (part["false"] + part["missed"]).astype(np.float64)
        if name != "truth":
            axis.plot(times, wrong, color=_COLOURS[name], linestyle=_STYLES[name], drawstyle="steps-mid", linewidth=1.6)
            maximum = max(maximum, float(wrong[in_scored_frames].max(initial=0.0)))
    axis.set_ylim(0.0, 1.1 * maximum)
    axis.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axis.set_ylabel("wrong objects\nin corridor", fontsize=10, color=INK)


def _draw_braking(axis: Axes, times: np.ndarray, parts: dict[str, Table]) -> None:
    """A lane per estimate: when it brakes, and whether it should."""
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    labelled: set[str] = set()
    for lane, part in enumerate(reversed(list(parts.values()))):
        wrong = part["needless"].astype(bool) | part["omitted"].astype(bool)
        for kind, (colour, words) in _BRAKING.items():
            mask = part[kind].astype(bool) & (~wrong if kind == "brake" else True)
            spans = _spans(times, mask, step)
            if spans or kind not in labelled:
                label = "" if kind in labelled else words
                axis.broken_barh(spans, (lane + 0.12, 0.76), facecolors=colour, label=label)
                labelled.add(kind)
    if not any(part[kind].any() for part in parts.values() for kind in _BRAKING):
        _annotate(axis, "no braking, by any of the three")
    axis.set_yticks(
        np.arange(len(parts)) + 0.5,
        [ESTIMATES[name].replace(" with ", " with\n") for name in reversed(parts)],
        fontsize=8,
    )
    axis.set_ylim(0.0, len(parts))
    axis.grid(visible=False)


def _annotate(axis: Axes, message: str) -> None:
    """Write into an empty chart why it is empty."""
    box = {"facecolor": "white", "edgecolor": "none", "pad": 3.0}
    placement: dict[str, Any] = {"transform": axis.transAxes, "ha": "center", "va": "center", "zorder": 5}
    axis.text(0.5, 0.5, message, fontsize=9, color=LOCAL, bbox=box, **placement)


def _spans(times: np.ndarray, mask: np.ndarray, step: float) -> list[tuple[float, float]]:
    """(start, length) of each run of frames in a mask.

    A frame lasts one step and is centred on its time.
    """
    edges = np.diff(mask.astype(np.int64), prepend=0, append=0)
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return [(float(times[a]) - step / 2, float(times[b] - times[a]) + step) for a, b in zip(first, last, strict=True)]
