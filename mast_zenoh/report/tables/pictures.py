"""Runs without a centre: a table of the agents' own pictures, and sentences about these and the radio channel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.report.tables.text_table import DASH, Head, Line, PageTable, whole_percent
from mast_zenoh.runs.run import Run

_QUANTITIES = {"position": "positions", "velocity": "velocities"}
_HEADS = [
    Head("agent", kind="text"),
    Head("missed", "objects per frame"),
    Head("false", "objects per frame"),
    Head("RMSE (m)"),
    Head("deceived (% of the frames\nfrom the first lie on)"),
    Head("NEES of positions"),
]


def picture_table(run: Run) -> PageTable:
    """A line for each agent's picture; none where all agents get the same one."""
    pictures = run.files.summary.get("pictures", {})
    deceived = pictures.get("deceived", {}).get("agents", {})
    return PageTable(_HEADS, [_line(run.files.summary, agent, share) for agent, share in deceived.items()])


def _line(metrics: Mapping[str, Any], agent: str, deceived: float) -> Line:
    scores = metrics["agents"][agent][PICTURE]
    position = metrics["consistency"].get(agent, {}).get(PICTURE, {}).get("position", {})
    cells = [_number(each) for each in (scores["fn"]["mean"], scores["fp"]["mean"], scores["rmse_m"])]
    nees = _number(position.get("nees"))
    nees += f" (bound {_number(position['high'])})" if exceeds(position) else ""
    return Line((agent, *cells, whole_percent(deceived), nees), "bad" if exceeds(position) else "")


def exceeds(summary: Mapping[str, Any]) -> bool:
    """Whether the mean NEES of a summary is above its 95 % bounds, whatever its median is."""
    return summary.get("nees") is not None and summary.get("high") is not None and summary["nees"] > summary["high"]


def picture_sentences(run: Run) -> list[str]:
    """How far the agents' pictures differ, and how many agents attacks deceived; [] where all get the same picture."""
    pictures = run.files.summary.get("pictures", {})
    if not pictures:
        return []
    difference, deceived = pictures["difference_gospa_m"]["mean"], pictures["deceived"]
    apart = (
        "" if difference is None else f"; GOSPA between two: {difference:.1f} m, mostly objects that one of them lacks"
    )
    sentences = [f"{pictures['count']} agents have pictures of their own{apart}"]
    if deceived["first_s"] is not None:
        share, most, first_s = deceived["share"]["mean"] or 0.0, deceived["most"], deceived["first_s"]
        lies_from_s = deceived.get("lies_from_s")
        since = "" if lies_from_s is None else f" from the first lie on ({lies_from_s:.1f} s)"
        parts = f"{whole_percent(share)} % of them at a time{since}, at most {whole_percent(most)} %"
        sentences.append(f"Attacks deceived {parts}, first at {first_s:.1f} s")
    return [*sentences, *_consistency(pictures)]


def _consistency(pictures: Mapping[str, Any]) -> list[str]:
    """In how many pictures errors are larger than covariances say; [] if in none."""
    too_high = {name: each for name, each in pictures.get("consistency", {}).items() if each["above"]}
    if not too_high:
        return []
    parts = [
        f"{_QUANTITIES[name]} in {len(each['above'])} of {pictures['count']} pictures (on average {each['nees']:.1f})"
        for name, each in too_high.items()
    ]
    return [f"Errors are larger than covariances say (NEES above its 95 % bounds, 2 expected): {', '.join(parts)}"]


def channel_sentences(run: Run) -> list[str]:
    """The load of the radio channel, and what arrived; [] without one."""
    channel = run.files.summary.get("channel", {})
    if not channel:
        return []
    arrived = channel["arrived"]
    of_messages = "no message was sent" if arrived is None else f"{100.0 * arrived:.1f} % of the messages arrived"
    busy, sent = map(whole_percent, (channel["busy_ratio"]["mean"] or 0.0, channel["sent"]))
    stations = f"Radio channel of {channel['stations']} stations"
    return [f"{stations}: {busy} % busy; a station sent in {sent} % of the frames; {of_messages}"]


def _number(value: float | None, digits: int = 2) -> str:
    return DASH if value is None else f"{value:.{digits}f}"
