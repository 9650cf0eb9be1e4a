"""What interposers say they did, held against what was measured: labels where it is true, contradictions where not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.matching import greedy
from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.effects.message_effects import DELAYED, DROPPED, REFRAMED, REPEATED, RESTAMPED, UNSETTLED
from mast_zenoh.effects.table import CODE, EFFECTS, Effects
from mast_zenoh.messages.schemas import Body
from mast_zenoh.metrics.boxes import pairs_within
from mast_zenoh.metrics.lookup import find, occurs
from mast_zenoh.metrics.manipulations import KINDS
from mast_zenoh.metrics.places import Places

#: m, from the place that a report names to that of the effect on the wire.
SAME_PLACE_M = 0.05
#: Effects on objects, in the order of `attacks.ACTIONS`.
_ACTIONS = ("inserted", "removed", "moved")
#: The effects in which each of `links.FATES` shows, in that order. A corrupted message may still be readable.
_FATES = ((DROPPED,), (DELAYED,), (REPEATED,), EFFECTS, (RESTAMPED, REFRAMED))


@dataclass(frozen=True, slots=True)
class Agreement:
    """How the reports of a run agree with its effects.

    reported:  (n,) bool of n effects: the interposer has reported it
    label:     (n,) int64, the number that it gave to the target, or the place of the link's rule; -1: none
    unfounded: by interposer, how many of its reports have no counterpart on the wires
    reports:   by interposer, how many changes it has reported
    """

    reported: Bools
    label: Ints
    unfounded: Mapping[str, int]
    reports: Mapping[str, int]


def compare(effects: Effects, attack_reports: Reports, link_reports: Reports, wires: Sequence[str]) -> Agreement:
    """Hold the reports of interposers against the measured effects.

    attack_reports: columns of messages `attack_report`; link_reports: of messages `link_report`
    wires: message types by the numbers that link reports use for them
    """
    nodes = sorted(
        {passage.node for passage in effects.passages} | {node for node, *_ in (*attack_reports, *link_reports)}
    )
    whose = np.array([nodes.index(passage.node) for passage in effects.passages], np.int64)[effects.passage]
    reported, label = np.zeros(len(effects), bool), np.full(len(effects), -1, np.int64)
    count, unfounded = np.zeros(len(nodes), np.int64), np.zeros(len(nodes), np.int64)
    for reports, columns, match in (
        (attack_reports, _CHANGES, partial(_objects, effects, whose)),
        (link_reports, _OF_LINKS, partial(_messages, effects, whose, wires)),
    ):
        said = _together(reports, columns, nodes)
        founded = match(said, reported, label)
        count += np.bincount(said["node"], minlength=len(nodes))
        unfounded += np.bincount(said["node"][~founded], minlength=len(nodes))
    named = [(node, int(n), int(m)) for node, n, m in zip(nodes, count, unfounded, strict=True)]
    return Agreement(reported, label, {node: m for node, _, m in named if m}, {node: n for node, n, _ in named if n})


#: Reports of one kind: interposer, frame, sequence number, columns.
Reports = Sequence[tuple[str, int, int, Body]]
_CHANGES = ("action", "target", "before_position", "after_position")
_OF_LINKS = ("port", "frame", "seq", "fate", "rule")


def _together(reports: Reports, columns: tuple[str, ...], nodes: Sequence[str]) -> dict[str, NDArray[Any]]:
    """All rows of reports: their columns, `node` (n,), row of `nodes`, and `of_frame` (n,), that of the report."""
    ordered = sorted(reports, key=lambda report: report[:3])
    rows = [len(body[columns[0]]) for *_, body in ordered]
    result: dict[str, NDArray[Any]] = {
        "node": np.repeat(np.array([nodes.index(node) for node, *_ in ordered], np.int64), rows),
        "of_frame": np.repeat(np.array([frame for _, frame, *_ in ordered], np.int64), rows),
    }
    for name in columns:
        empty = np.zeros((0, 3)) if name.endswith("position") else np.zeros(0, np.int64)
        result[name] = np.concatenate([empty, *(body[name].astype(empty.dtype) for *_, body in ordered)])
    return result


def _objects(effects: Effects, whose: Ints, said: Mapping[str, NDArray[Any]], reported: Bools, label: Ints) -> Bools:
    """Mark the effects that reports of adversaries name; (n,) which of n rows of reports name one.

    What counts is at which places objects are gone, and at which they appear. Without ids, an object that is removed
    while another one is inserted beside it cannot be told from one that was moved: either report is right.
    """
    # Frames are numbered anew: messages and reports may name any.
    known, numbers = np.unique(np.concatenate([effects.frame, said["of_frame"]]), return_inverse=True)
    span, frame = len(known), np.split(numbers.reshape(-1), [len(effects)])
    names = np.array(_ACTIONS)[said["action"]]
    group = said["node"] * span + frame[1]
    claimed = _events(names, said["before_position"], said["after_position"], group)
    mine = np.flatnonzero(~effects.whole & (effects.code < len(KINDS)))
    code = np.array(EFFECTS)[effects.code[mine]]
    group = whose[mine] * span + frame[0][mine]
    measured = _events(code, effects.before[mine], effects.after[mine], group)
    i, j = pairs_within(claimed.places.boxes(), measured.places.boxes(), SAME_PLACE_M)
    apart = np.linalg.norm(claimed.places.position[i] - measured.places.position[j], axis=1)
    near = apart <= SAME_PLACE_M
    i, j, apart = i[near], j[near], apart[near]
    chosen = greedy(i, j, apart)
    i, j = i[chosen], j[chosen]
    label[mine[measured.row[j]]] = said["target"][claimed.row[i]]
    reported[mine] |= _complete(measured, j, len(mine))
    return _complete(claimed, i, len(names))


class _Events(NamedTuple):
    """Objects that appear at a place or are gone from it: the places, in groups that only like events of one interposer
    and frame share, and the row (n,) of the change that each is part of."""

    places: Places
    row: Ints


def _events(names: NDArray[np.str_], before: Floats, after: Floats, group: Ints) -> _Events:
    gone, come = (
        np.flatnonzero(np.isin(names, ("removed", "moved"))),
        np.flatnonzero(np.isin(names, ("inserted", "moved"))),
    )
    gone, come = gone[np.isfinite(before[gone]).all(axis=1)], come[np.isfinite(after[come]).all(axis=1)]
    row = np.concatenate([gone, come])
    appears = np.repeat([0, 1], [len(gone), len(come)])
    return _Events(Places(2 * group[row] + appears, np.concatenate([before[gone], after[come]])), row)


def _complete(events: _Events, matched: Ints, count: int) -> Bools:
    """(count,) changes that have events, all of which are matched."""
    total = np.bincount(events.row, minlength=count)
    return np.asarray((total > 0) & (np.bincount(events.row[matched], minlength=count) == total))


def _messages(
    effects: Effects,
    whose: Ints,
    wires: Sequence[str],
    said: Mapping[str, NDArray[Any]],
    reported: Bools,
    label: Ints,
) -> Bools:
    """Mark the effects that reports of links name; (n,) which of n rows of reports name one."""
    kinds = list(dict.fromkeys((*wires, *(passage.message for passage in effects.passages))))
    kind = np.array([kinds.index(passage.message) for passage in effects.passages], np.int64)[effects.passage]
    founded = np.zeros(len(said["fate"]), bool)
    for fate, names in enumerate(_FATES):
        rows = np.flatnonzero(~effects.whole & np.isin(effects.code, [CODE[name] for name in names]))
        mine = np.flatnonzero(said["fate"] == fate)
        measured = whose[rows], kind[rows], effects.frame[rows], effects.seq[rows]
        claimed = said["node"][mine], said["port"][mine], said["frame"][mine], said["seq"][mine]
        at = find(measured, claimed)
        reported[rows[at >= 0]] = True
        label[rows[at >= 0]] = said["rule"][mine[at[at >= 0]]]
        founded[mine] |= occurs(claimed, measured)
    return founded


def summary(
    effects: Effects, agreement: Agreement, roles: Mapping[str, str], last_step: int, absent: Bools
) -> dict[str, Any]:
    """By interposer: role, wires, how many messages it received, its effects counted, and whether its reports agree
    with them: "agrees", "silent" (it changed something and reported nothing), "disagrees", or "nothing to report".

    last_step: the last frame of the run; what was done in it no link reports any more
    absent:    (n,) effects that are due to the interposer not being there; they are counted by themselves
    """
    result: dict[str, Any] = {}
    node_of = np.array([passage.node for passage in effects.passages], object)
    whose = node_of[effects.passage] if len(effects) else np.zeros(0, object)
    settled = (effects.code != CODE[UNSETTLED]) & (effects.step < last_step)
    for node in dict.fromkeys(node_of.tolist()):
        mine = whose == node
        # Objects of a message that was withheld or forged as a whole are told of by the message.
        shown = mine & ~effects.whole & ~absent
        reports = agreement.reports.get(node, 0)
        unreported = int(np.count_nonzero(shown & settled & ~agreement.reported))
        unfounded = agreement.unfounded.get(node, 0)
        changed = bool(np.any(shown & settled))
        if not changed and not reports:
            verdict = "nothing to report"
        elif changed and not reports:
            verdict = "silent"
        else:
            verdict = "disagrees" if unreported or unfounded else "agrees"
        places = [k for k, passage in enumerate(effects.passages) if passage.node == node]
        counts = np.bincount(effects.code[shown], minlength=len(EFFECTS))
        result[str(node)] = {
            "role": roles.get(str(node), ""),
            "wires": list(dict.fromkeys(effects.passages[k].wire for k in places)),
            "messages": sum(effects.received[k] for k in places),
            "effects": {name: int(n) for name, n in zip(EFFECTS, counts, strict=True) if n},
            "absent": int(np.count_nonzero(mine & ~effects.whole & absent)),
            "reports": reports,
            "agreement": verdict,
            "unreported": unreported,
            "unfounded": unfounded,
        }
    return result
