"""What a recording lacks of its run: the notices of a replay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch.ending import RUNNING
from mast_zenoh.launch.folder import versions
from mast_zenoh.launch.notices import number, of_recording
from mast_zenoh.messagelog import churn

_PACKAGE = "mast-zenoh"


def of_run(record: Mapping[str, Any], resolved: Resolved) -> list[str]:
    """A sentence for each circumstance of a recorded run that its replay does not share.

    record: run.json
    """
    sentences = []
    status, message = record.get("status"), str(record.get("message") or "")
    if status == RUNNING:
        sentences.append("the recorded run has not ended, by its run.json, and was started on another machine")
    elif status != "ok":
        reason = f": {message.splitlines()[0]}" if message else ""
        sentences.append(f"the recorded run ended as {str(status).replace('_', ' ')!r}{reason}")
    recorded_by, here = (record.get("versions") or {}).get(_PACKAGE), versions()[_PACKAGE]
    if recorded_by != here:
        sentences.append(
            f"recorded by {_PACKAGE} {recorded_by or 'of an unknown version'}, replayed by {here}: live nodes may "
            "compute other numbers"
        )
    if record.get("mode") == "realtime":
        sentences.append(
            "recorded in real time, where late messages are late: the picture depended on the speed of the machine and "
            "may differ from the recorded one"
        )
    if resolved.network:
        sentences.append(
            "recorded on hosts in network namespaces, which are not set up again: messages are played as the recorder "
            "received them, though other nodes may not have"
        )
    if record.get("churn"):
        sentences.append(
            f"{churn.sentence(record['churn'])} in the recorded run: in the replay these nodes stay, and played ones "
            "send what was recorded"
        )
    return [*sentences, *of_recording(record)]


def of_extent(played: int, recorded: int, planned: int, *, whole: bool) -> list[str]:
    """A sentence if not all frames of the run can be played.

    played, recorded, planned: numbers of frames;  whole: whether the recording was closed properly
    """
    if recorded >= planned or played < recorded:
        return []
    reason = "" if whole else " (its writer was killed, or the file was cut off)"
    return [f"the recording ends after {number(recorded, 'whole frame')} of {planned}{reason}: these are played"]


def of_gaps(gaps: Mapping[str, int]) -> list[str]:
    """A sentence about messages that were sent and not recorded; gaps: their number by wire."""
    missing = {wire: count for wire, count in gaps.items() if count}
    if not missing:
        return []
    worst = max(sorted(missing), key=lambda wire: missing[wire])
    where = f"{number(len(missing), 'wire')} (most: {worst}, {missing[worst]})"
    return [f"{number(sum(missing.values()), 'message')} on {where} were not recorded, and are not played"]


def of_clocks(missing: int) -> list[str]:
    """A sentence about frames without a recorded clock."""
    if not missing:
        return []
    return [f"no clock is recorded of {number(missing, 'frame')}: the times are multiples of the scene's period"]


def of_outsiders(count: int) -> list[str]:
    """A sentence about messages that no node of the recorded run sent."""
    if not count:
        return []
    return [f"{number(count, 'message')} without the mark of the run's nodes are not played: outsiders sent them"]


def of_silent(wires: list[str]) -> list[str]:
    """A sentence about wires to live nodes without any recorded message."""
    if not wires:
        return []
    more = f" and {len(wires) - 3} more" if len(wires) > 3 else ""
    return [f"no message is recorded on {', '.join(wires[:3])}{more}"]


def of_rewired(nodes: list[str]) -> list[str]:
    """A sentence about nodes that were inserted or removed during the run."""
    if not nodes:
        return []
    return [
        f"{', '.join(nodes)} was inserted or removed during the recorded run: what its wires then carried is played, "
        "without measuring its effect"
    ]


def of_unconnected(ports: list[str]) -> list[str]:
    """A sentence about inputs of changed nodes that no recorded wire leads to; ports: as node.port."""
    if not ports:
        return []
    return [f"no recorded wire leads to {', '.join(ports)}: these inputs get no messages"]


def of_steps(steps: list[ProcessStep]) -> list[str]:
    """A sentence about process steps of the recorded run that the replay leaves out."""
    if not steps:
        return []
    text = ", ".join(f"{step.action} {step.node}" for step in steps[:3])
    more = f" and {len(steps) - 3} more" if len(steps) > 3 else ""
    return [f"not repeated: {text}{more}; what the nodes then sent, or did not send, is played"]
