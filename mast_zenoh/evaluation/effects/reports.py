"""Compares the reports of interposers with the measured effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.evaluation.effects.passages import DELAYED, DROPPED, REFRAMED, REPEATED, RESTAMPED, SLANDERED, UNSETTLED
from mast_zenoh.evaluation.effects.table import CODE, EFFECTS, Effects
from mast_zenoh.links import type_number
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.assignment import Places, find, occurs, pairs_within
from mast_zenoh.metrics.causes import KINDS
from mast_zenoh.wiring.model import InterposedWire

#: m, maximum distance between the position in a report and the effect's position on the wire.
SAME_PLACE_M = 0.05
#: Effects on objects, in the order of `attacks.ACTIONS`.
_ACTIONS = ("inserted", "removed", "moved", "altered", REFRAMED)
#: Types of messages whose changed objects adversaries report; of others they report that they changed.
_WITH_OBJECTS = ("detections", "tracks", "picture")
#: The effects that correspond to each of `links.FATES`, in that order. A corrupted message may still be readable.
#: A wrong pose moves the sender in messages about itself, and else the frame of reference.
_FATES = ((DROPPED, UNSETTLED), (DELAYED, UNSETTLED), (REPEATED,), EFFECTS, (RESTAMPED, REFRAMED, "moved"), KINDS)


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement between the reports and the measured effects of a run.

    reported:  (n,) bool, whether each of n effects was reported by its interposer
    label:     (n,) int64, the reported number of the target or index of the link's rule; -1: none
    unfounded: by interposer, number of reports without a measured effect
    reports:   by interposer, number of reported changes
    """

    reported: Bools
    label: Ints
    unfounded: Mapping[str, int]
    reports: Mapping[str, int]


def compare(
    effects: Effects,
    attack_reports: Reports,
    link_reports: Reports,
    counted: tuple[float, float] = (-np.inf, np.inf),
) -> Agreement:
    """Compare the reports of interposers with the measured effects.

    attack_reports: columns of messages `attack_report`; link_reports: of messages `link_report`
    counted: first frame of the reports that are counted, and the one after the last
    """
    nodes = sorted(
        {passage.node for passage in effects.passages} | {node for node, *_ in (*attack_reports, *link_reports)}
    )
    node_row = np.array([nodes.index(passage.node) for passage in effects.passages], np.int64)[effects.passage]
    reported, label = np.zeros(len(effects), bool), np.full(len(effects), -1, np.int64)
    count, unfounded = np.zeros(len(nodes), np.int64), np.zeros(len(nodes), np.int64)
    for reports, columns, match in (
        (attack_reports, _ATTACK_COLUMNS, partial(_match_attacks, effects, node_row)),
        (link_reports, _LINK_COLUMNS, partial(_match_links, effects, node_row)),
    ):
        reported_rows = _concatenate(reports, columns, nodes)
        confirmed = match(reported_rows, reported, label)
        counts_here = (counted[0] <= reported_rows["report_frame"]) & (reported_rows["report_frame"] < counted[1])
        count += np.bincount(reported_rows["node"][counts_here], minlength=len(nodes))
        unfounded += np.bincount(reported_rows["node"][counts_here & ~confirmed], minlength=len(nodes))
    counts = [(node, int(n), int(m)) for node, n, m in zip(nodes, count, unfounded, strict=True)]
    return Agreement(reported, label, {node: m for node, _, m in counts if m}, {node: n for node, n, _ in counts if n})


#: Reports of one kind: interposer, frame, sequence number, columns.
Reports = Sequence[tuple[str, int, int, Body]]
_ATTACK_COLUMNS = ("action", "target", "before_position", "after_position")
_LINK_COLUMNS = ("port", "frame", "seq", "fate", "rule")


def _concatenate(reports: Reports, columns: tuple[str, ...], nodes: Sequence[str]) -> dict[str, NDArray[Any]]:
    """All rows of reports, with reporting node and frame.

    `node` (n,) is a row of `nodes`, `report_frame` (n,) the frame of the report.
    """
    ordered = sorted(reports, key=lambda report: report[:3])
    rows = [len(body[columns[0]]) for *_, body in ordered]
    result: dict[str, NDArray[Any]] = {
        "node": np.repeat(np.array([nodes.index(node) for node, *_ in ordered], np.int64), rows),
        "report_frame": np.repeat(np.array([frame for _, frame, *_ in ordered], np.int64), rows),
    }
    for name in columns:
        empty = np.zeros((0, 3)) if name.endswith("position") else np.zeros(0, np.int64)
        result[name] = np.concatenate([empty, *(body[name].astype(empty.dtype) for *_, body in ordered)])
    return result


def _match_attacks(
    effects: Effects, node_row: Ints, reported_rows: Mapping[str, NDArray[Any]], reported: Bools, label: Ints
) -> Bools:
    """Mark the effects that adversaries reported.

    Returns which of n rows of reports match an effect.
    Reports are matched by the positions at which objects disappear and appear. Without ids, a removed object with an
    inserted one nearby cannot be distinguished from a moved one: either report is correct. Changed poses and views are
    matched by their frame.
    """
    # Frames are renumbered, since messages and reports may contain any number.
    known, numbers = np.unique(np.concatenate([effects.frame, reported_rows["report_frame"]]), return_inverse=True)
    span, frame = len(known), np.split(numbers.reshape(-1), [len(effects)])
    names = np.array(_ACTIONS)[reported_rows["action"]]
    group = reported_rows["node"] * span + frame[1]
    claimed = _events(names, reported_rows["before_position"], reported_rows["after_position"], group)
    rows = np.flatnonzero(~effects.whole & (effects.code < len(KINDS)))
    code = np.array(EFFECTS)[effects.code[rows]]
    group = node_row[rows] * span + frame[0][rows]
    measured = _events(code, effects.before[rows], effects.after[rows], group)
    i, j = pairs_within(claimed.places, measured.places, SAME_PLACE_M)
    distance = np.linalg.norm(claimed.places.position[i] - measured.places.position[j], axis=1)
    near = distance <= SAME_PLACE_M
    i, j, distance = i[near], j[near], distance[near]
    matches = greedy_matching(i, j, distance)
    i, j = i[matches], j[matches]
    label[rows[measured.row[j]]] = reported_rows["target"][claimed.row[i]]
    reported[rows] |= _complete(measured, j, len(rows))
    confirmed = _complete(claimed, i, len(names))
    claims = np.flatnonzero(names == REFRAMED)
    group = reported_rows["node"] * span + frame[1]
    of_type = np.array([passage.message not in _WITH_OBJECTS for passage in effects.passages], bool)
    whole = np.isin(effects.code, [CODE[REFRAMED], CODE[SLANDERED]]) | (effects.code < len(KINDS))
    rows = np.flatnonzero(whole & of_type[effects.passage])
    changed = node_row[rows] * span + frame[0][rows]
    reported[rows] |= np.isin(changed, group[claims])
    confirmed[claims] = np.isin(group[claims], changed)
    return confirmed


class _Events(NamedTuple):
    """Appearances and disappearances of objects.

    row: (n,) the change that each belongs to.
    Groups contain only events of the same kind, interposer and frame.
    """

    places: Places
    row: Ints


def _events(names: NDArray[np.str_], before: Floats, after: Floats, group: Ints) -> _Events:
    disappeared = np.flatnonzero(np.isin(names, ("removed", "moved", "altered")))
    disappeared = disappeared[np.isfinite(before[disappeared]).all(axis=1)]
    appeared = np.flatnonzero(np.isin(names, ("inserted", "moved", "altered")))
    appeared = appeared[np.isfinite(after[appeared]).all(axis=1)]
    row = np.concatenate([disappeared, appeared])
    is_appearance = np.repeat([0, 1], [len(disappeared), len(appeared)])
    return _Events(Places(2 * group[row] + is_appearance, np.concatenate([before[disappeared], after[appeared]])), row)


def _complete(events: _Events, matched: Ints, count: int) -> Bools:
    """(count,) whether each change has events and all of them are matched."""
    total = np.bincount(events.row, minlength=count)
    return np.asarray((total > 0) & (np.bincount(events.row[matched], minlength=count) == total))


def _match_links(
    effects: Effects,
    node_row: Ints,
    reported_rows: Mapping[str, NDArray[Any]],
    reported: Bools,
    label: Ints,
) -> Bools:
    """Mark the effects that links reported.

    Returns which of n rows of reports match an effect.
    """
    message_type = np.array([type_number(each.message) for each in effects.passages], np.int64)[effects.passage]
    confirmed = np.zeros(len(reported_rows["fate"]), bool)
    for fate, names in enumerate(_FATES):
        rows = np.flatnonzero(~effects.whole & np.isin(effects.code, [CODE[name] for name in names]))
        report_rows = np.flatnonzero(reported_rows["fate"] == fate)
        measured = node_row[rows], message_type[rows], effects.frame[rows], effects.seq[rows]
        claimed = (
            reported_rows["node"][report_rows],
            reported_rows["port"][report_rows],
            reported_rows["frame"][report_rows],
            reported_rows["seq"][report_rows],
        )
        matches = find(measured, claimed)
        reported[rows[matches >= 0]] = True
        label[rows[matches >= 0]] = reported_rows["rule"][report_rows[matches[matches >= 0]]]
        confirmed[report_rows] |= occurs(claimed, measured)
    return confirmed


@dataclass(slots=True)
class ReportCounts:
    """Numbers of the effects of one interposer, and of its reports.

    effects: (len(EFFECTS),) by effect;  absent: due to its absence;  changes: effects that it can have reported
    reports: reported changes;  unreported: changes without a report;  unfounded: reports without a change
    """

    effects: Ints = field(default_factory=lambda: np.zeros(len(EFFECTS), np.int64))
    absent: int = 0
    changes: int = 0
    reports: int = 0
    unreported: int = 0
    unfounded: int = 0

    @property
    def agreement(self) -> str:
        """Whether the reports agree: "agrees", "silent" (changes, no report), "disagrees" or "nothing to report"."""
        if not self.reports:
            return "silent" if self.changes else "nothing to report"
        return "disagrees" if self.unreported or self.unfounded else "agrees"


def add_counts(
    counts: dict[str, ReportCounts],
    effects: Effects,
    agreement: Agreement,
    last_step: int,
    absent: Bools,
    counted: Bools,
) -> None:
    """Add the effects and reports of a part of a run to those of each interposer.

    last_step: the last frame of the run; links do not report effects in it
    absent:    (n,) effects due to the absence of the interposer; counted separately
    counted:   (n,) effects of this part
    """
    node_of = np.array([passage.node for passage in effects.passages], object)
    node_row = node_of[effects.passage] if len(effects) else np.zeros(0, object)
    settled = (effects.code != CODE[UNSETTLED]) & (effects.step < last_step)
    for node in dict.fromkeys(node_of.tolist()):
        # Objects of a withheld or forged message are covered by the effect on the message.
        of_node = (node_row == node) & ~effects.whole & counted
        present = of_node & ~absent
        sums = counts.setdefault(str(node), ReportCounts())
        sums.effects += np.bincount(effects.code[present], minlength=len(EFFECTS))
        sums.absent += int(np.count_nonzero(of_node & absent))
        sums.changes += int(np.count_nonzero(present & settled))
        sums.reports += agreement.reports.get(node, 0)
        sums.unreported += int(np.count_nonzero(present & settled & ~agreement.reported))
        sums.unfounded += agreement.unfounded.get(node, 0)


def summary(
    counts: Mapping[str, ReportCounts], passages: Sequence[tuple[InterposedWire, int]], roles: Mapping[str, str]
) -> dict[str, Any]:
    """Summarise each interposer and the agreement of its reports.

    counts: by interposer;  passages: each with the number of messages that it received

    Keys:
    role, wires: of the node; keys of the wires that it is on
    messages: number that it received
    effects: by effect, the number that was measured
    absent: effects of its absence
    reports, unreported, unfounded: reports; effects without a report; reports without an effect
    agreement: `agrees`, `silent`, `disagrees` or `nothing to report`
    """
    return {
        node: {
            "role": roles.get(node, ""),
            "wires": list(dict.fromkeys(passage.wire for passage, _ in passages if passage.node == node)),
            "messages": sum(received for passage, received in passages if passage.node == node),
            "effects": {name: int(n) for name, n in zip(EFFECTS, sums.effects, strict=True) if n},
            "absent": sums.absent,
            "reports": sums.reports,
            "agreement": sums.agreement,
            "unreported": sums.unreported,
            "unfounded": sums.unfounded,
        }
        for node, sums in counts.items()
    }
