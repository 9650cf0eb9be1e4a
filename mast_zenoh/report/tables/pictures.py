"""Runs without a centre: a table of the agents' own pictures, and sentences about these and the radio channel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.report.tables.text_table import DASH, Head, Line, PageTable
from mast_zenoh.viewer.run import RunRecord

_HEADS = [
    Head("agent", kind="text"),
    Head("missed", "objects per frame"),
    Head("false", "objects per frame"),
    Head("RMSE (m)"),
    Head("deceived (% of the frames\nfrom the first lie on)"),
    Head("NEES of positions"),
]


def picture_table(run: RunRecord) -> PageTable:
    """A line for each agent's picture; none where all agents get the same one."""
    pictures = run.metrics.get("pictures", {})
    deceived = pictures.get("deceived", {}).get("agents", {})
    return PageTable(_HEADS, [_line(run.metrics, agent, share) for agent, share in deceived.items()])


def _line(metrics: Mapping[str, Any], agent: str, deceived: float) -> Line:
    scores = metrics["agents"][agent][PICTURE]
    nees = metrics["consistency"].get(agent, {}).get(PICTURE, {}).get("position", {}).get("nees")
    cells = [_number(each) for each in (scores["fn"]["mean"], scores["fp"]["mean"], scores["rmse_m"])]
    return Line((agent, *cells, _number(100.0 * deceived, 0), _number(nees)))


def picture_sentences(run: RunRecord) -> list[str]:
    """How far the agents' pictures differ, and how many agents attacks deceived; [] where all get the same picture."""
    pictures = run.metrics.get("pictures", {})
    if not pictures:
        return []
    difference, deceived = pictures["difference_gospa_m"]["mean"], pictures["deceived"]
    apart = "" if difference is None else f", {difference:.1f} m apart (GOSPA)"
    sentences = [f"{pictures['count']} agents have pictures of their own{apart}"]
    if deceived["first_s"] is not None:
        share, most, first_s = deceived["share"]["mean"] or 0.0, deceived["most"], deceived["first_s"]
        lies_from_s = deceived.get("lies_from_s")
        since = "" if lies_from_s is None else f" from the first lie on ({lies_from_s:.1f} s)"
        when = f"{100.0 * share:.0f} % of them at a time{since}, at most {100.0 * most:.0f} %, first at {first_s:.1f} s"
        sentences.append(f"Attacks deceived {when}")
    return sentences


def channel_sentences(run: RunRecord) -> list[str]:
    """The load of the radio channel, and what arrived; [] without one."""
    channel = run.metrics.get("channel", {})
    if not channel:
        return []
    arrived = channel["arrived"]
    of_messages = "no message was sent" if arrived is None else f"{100.0 * arrived:.1f} % of the messages arrived"
    busy, sent = (100.0 * share for share in (channel["busy_ratio"]["mean"] or 0.0, channel["sent"]))
    stations = f"Radio channel of {channel['stations']} stations"
    return [f"{stations}: {busy:.0f} % busy; a station sent in {sent:.0f} % of the frames; {of_messages}"]


def _number(value: float | None, digits: int = 2) -> str:
    return DASH if value is None else f"{value:.{digits}f}"
