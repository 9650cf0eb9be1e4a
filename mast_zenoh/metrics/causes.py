"""Causes of errors: what interposers did to objects, which estimates that reaches, and counts by cause."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats, Ints, within_runs
from mast_zenoh.metrics.assignment import Places
from mast_zenoh.metrics.scores import Scores, Texts

#: Kinds of manipulation, by their code.
KINDS = ("inserted", "removed", "moved", "altered")
INSERTED, REMOVED, MOVED, ALTERED = range(len(KINDS))

#: The columns of `Manipulations` with a row for each of them.
ROW_COLUMNS = ("passage", "culprit", "kind", "frame", "object", "position", "original", "velocity", "lasts", "of_box")


@dataclass(frozen=True, slots=True)
class Manipulations:
    """n manipulations of objects.

    culprits: c names of adversaries and other interposers except links, sorted
    passage:  (n,) row of `reach`: an interposer on a wire
    culprit:  (n,) row of `culprits`; -1: a link, which counts as a fault
    kind:     (n,) index into KINDS
    frame:    (n,)
    object:   (n,) episode of an insertion, else the id of the truth object; below 0: unknown
    position: (n, 3) m, world frame: the claimed position, or the original one of a removed object
    original: (n, 3) m, world frame: the original position; NaN for an inserted object
    velocity: (n, 3) m/s, world frame; zero if unknown
    lasts:    (n,) number of frames after its own in which it still counts
    of_box:   (n,) bool, altered in size, heading and class alone: the object is found where it was
    reach:    (p, s) bool: which of s series can lack or displace an object because of each of p passages
    altered:  (p, s) bool: which can because of an object that was altered and not moved: not what is judged as sent
    shown:    (p, s) bool: which can have a false track because of it
    delay:    (p, s) number of frames after its own from which on a manipulation can have been used for each series
    """

    culprits: tuple[str, ...]
    reach: Bools
    altered: Bools
    shown: Bools
    delay: Ints
    passage: Ints
    culprit: Ints
    kind: Ints
    frame: Ints
    object: Ints
    position: Floats
    original: Floats
    velocity: Floats
    lasts: Ints
    of_box: Bools

    def __len__(self) -> int:
        return len(self.kind)

    def select(self, rows: Bools | Ints) -> Manipulations:
        """The rows selected by a mask or an index array."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ROW_COLUMNS})

    @classmethod
    def joined(cls, parts: Sequence[Manipulations]) -> Manipulations:
        """The manipulations of several parts of a run, in that order; passages are those of the last part."""
        culprits = tuple(sorted({name for part in parts for name in part.culprits}))
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ROW_COLUMNS}
        rows = [np.array([*(culprits.index(name) for name in part.culprits), -1], np.int64) for part in parts]
        columns["culprit"] = np.concatenate([row[part.culprit] for row, part in zip(rows, parts, strict=True)])
        return replace(parts[-1], culprits=culprits, **columns)

    def first_shown(self, series: Ints, by: Bools, span: int) -> Ints:
        """First frame (n,) in which a series can have an object that any of the culprits (n, c) showed.

        `span` if none did. The object must be visible in the series. For rows without a culprit, links are used.
        """
        first_frame = np.full((len(self.culprits) + 1, self.shown.shape[1]), span)  # the last row is for links
        shows = np.isin(self.kind, (INSERTED, MOVED))
        for culprit in range(-1, len(self.culprits)):
            rows = (shows & (self.culprit == culprit)).nonzero()[0]
            if len(rows):
                passage = self.passage[rows]
                frame = np.where(self.shown[passage], self.frame[rows, None] + self.delay[passage], span)
                first_frame[culprit] = frame.min(axis=0)
        responsible = np.column_stack([by, ~by.any(axis=1)])
        return np.asarray(np.where(responsible, first_frame[:, series].T, span).min(axis=1))


#: Causes of false tracks, missed objects and identity switches: attacks first, with the codes of KINDS.
CAUSES = (
    *KINDS,
    "duplicate",
    "lag",
    "occlusion or range",
    "clutter",
    "tracking",
    "fusion",
    "link or fault",
    "withheld",
)
DUPLICATE, LAG, SIGHT, CLUTTER, TRACKING, FUSION, FAULT, WITHHELD = range(len(KINDS), len(CAUSES))
UNKNOWN = -1
#: Names whose combinations fit in an integer.
_BITS = 62
#: Causes that count as attacks, as faults, and as the defence's doing; all others are natural.
ATTACK_CAUSES, FAULT_CAUSES, DEFENCE_CAUSES = KINDS, (CAUSES[FAULT],), (CAUSES[WITHHELD],)
#: The causes of each part of `split` but "natural", which is the rest.
PARTS = {"fault": FAULT_CAUSES, "attack": ATTACK_CAUSES, "withheld": DEFENCE_CAUSES}


def cause_names(causes: Ints) -> NDArray[np.object_]:
    """Names (n,) str of causes; empty for UNKNOWN."""
    return np.array([*CAUSES, ""], object)[causes]


def claimed_positions(manipulations: Manipulations, period_s: float, coast: int, span: int) -> tuple[Places, Places]:
    """Claimed and original positions of objects, extrapolated over `coast` frames and gaps.

    They are extrapolated at constant velocity, which covers tracks that coast. Groups are series * `span` + frame, for
    every series that can show the object.
    """
    order = np.lexsort((manipulations.frame, manipulations.object, manipulations.passage))
    manipulations = manipulations.select(order)
    steps = np.full(len(manipulations), coast + 1)
    same = (np.diff(manipulations.object) == 0) & (np.diff(manipulations.passage) == 0)
    steps[:-1] = np.where(same, np.minimum(np.diff(manipulations.frame), coast + 1), steps[:-1])
    row, lead_frames = np.repeat(np.arange(len(manipulations)), steps), within_runs(steps)
    parts = []
    for delay in np.unique(manipulations.delay).tolist():
        later = lead_frames + delay  # until the next one can have been used
        frame = manipulations.frame[row] + later
        passage = manipulations.passage[row]
        visible = (manipulations.shown & (manipulations.delay == delay))[passage] & (frame < span)[:, None]
        index, series = visible.nonzero()
        at = row[index]
        ahead = manipulations.velocity[at] * (later[index] * period_s)[:, None]
        group = series * span + frame[index]
        parts.append((group, manipulations.position[at] + ahead, manipulations.original[at] + ahead))
    group, position, original = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Places(group, position), Places(group, original)


class CauseLabels(NamedTuple):
    """Causes of the errors of a run.

    cause: (n,) of each row of `Scores.judged`, an index into CAUSES; UNKNOWN: no error
    by:    (n,) str, the adversaries, joined by "+" if several showed the same object; of a withheld object, the agents
           whose tracks of it were not believed; empty for other causes
    switch_cause, switch_by: (k,) likewise for `Scores.switches`
    """

    cause: Ints
    by: Texts
    switch_cause: Ints
    switch_by: Texts


@dataclass(frozen=True, slots=True)
class Hidden:
    """Truth objects that were removed, moved or altered, with their frames.

    parts: for each kind and passage: the kind, culprit (-1: a link), influenced series (s,) bool, frames after its own
           from which it counts in each (s,), ids of the objects and frames (n,), sorted by both, and the number of
           frames after that for which it counts
    """

    parts: tuple[tuple[int, int, Bools, Ints, Ints, Ints, int], ...]

    @classmethod
    def of(cls, manipulations: Manipulations, *, found: bool = False) -> Hidden:
        """The manipulations of known truth objects; manipulations by links are faults.

        found: only those that can change where an object is found, and in which series they can
        """
        parts = []
        if found:
            manipulations = manipulations.select(~manipulations.of_box)
        hidden = manipulations.select(((manipulations.kind != INSERTED) & (manipulations.object >= 0)).nonzero()[0])
        for passage in np.unique(hidden.passage).tolist():
            for kind in (REMOVED, MOVED, ALTERED):
                rows = ((hidden.passage == passage) & (hidden.kind == kind)).nonzero()[0]
                if not len(rows):
                    continue
                rows = rows[np.lexsort((hidden.frame[rows], hidden.object[rows]))]
                culprit = int(hidden.culprit[rows[0]])
                lasts = int(hidden.lasts[rows[0]])
                reach = hidden.altered if found and kind == ALTERED else hidden.reach
                where = reach[passage], hidden.delay[passage]
                parts.append((kind, culprit, *where, hidden.object[rows], hidden.frame[rows], lasts))
        return cls(tuple(parts))

    def recent(
        self,
        truth_id: Ints,
        frame: Ints,
        series: Ints,
        own: Bools,
        most: int | None = None,
        received: Bools | None = None,
        since: Ints | None = None,
        natural: int = 0,
    ) -> Iterator[tuple[int, int, Bools]]:
        """For each part, code of the cause, culprit, and whether objects (n,) were recently hidden.

        They must have been hidden from an influenced series.
        own: (s,) series of what the broker receives from an agent
        most: largest number of frames after the manipulation; None: as long as that counts
        received: (n,) objects that the broker received from some agent: no removal before it hid them; None: none
        since: (n,) first frame of an error of each object; None: any. One that was there before an adversary first hid
            the object goes on by itself for `natural` frames
        """
        if not len(truth_id):
            return
        for kind, culprit, reach, delay, ids, frames, lasts in self.parts:
            span = int(max(frames.max(), frame.max())) + 1
            known = ids * span + frames
            usable = np.maximum(frame - delay[series], -1)  # a message of frame 0 has not arrived in frame 0
            last = np.searchsorted(known, truth_id * span + usable, side="right") - 1
            longest = lasts if most is None else min(lasts, most)
            same = (last >= 0) & (ids[last] == truth_id) & (frame - frames[last] <= longest)
            if since is not None and culprit >= 0:
                first = np.minimum(np.searchsorted(known, truth_id * span), len(known) - 1)
                first_hidden = frames[first] + delay[series]
                same &= (since >= first_hidden) | (frame >= first_hidden + natural)
            if received is not None and kind == REMOVED and (reach & own).any():
                same &= ~received
            yield (kind if culprit >= 0 else FAULT), culprit, same & reach[series]


def joined_names(names: Sequence[str], by: Bools) -> NDArray[np.object_]:
    """The names set in each row of (n, a), joined by "+", (n,) str."""
    result = np.full(len(by), "", object)
    nonempty = np.flatnonzero(by.any(axis=1))
    code = np.zeros(len(nonempty), np.int64)  # the same for the same names
    for column in by[nonempty].T:
        code = 2 * code + column
        if len(names) > _BITS:
            code = np.unique(code, return_inverse=True)[1]
    _, first, kind = np.unique(code, return_index=True, return_inverse=True)
    rows = by[nonempty[first]].tolist()
    labels = ["+".join(name for name, is_set in zip(names, row, strict=True) if is_set) for row in rows]
    result[nonempty] = np.array([*labels, ""], object)[kind]
    return result


#: By error, "fp", "fn" and "id_switches": numbers (s, len(CAUSES)) of each of s series by cause.
CauseCounts = Mapping[str, Ints]


def cause_counts(scores: Scores, cause: Ints, switch_cause: Ints, frames: Ints) -> CauseCounts:
    """Numbers of errors by cause of `scores.series` in these frames.

    cause, switch_cause: of `scores.judged` and `scores.switches`, as returned by `Attributor.labels`
    """
    n = len(scores.series)
    rows = np.flatnonzero(cause != UNKNOWN)
    rows = rows[np.isin(scores.judged.frame[rows], frames)]
    track, series = scores.judged.is_track[rows], scores.judged.series[rows]
    switched = np.isin(scores.frames[scores.switches.frame], frames)
    return {
        "fp": _count_causes(series[track], cause[rows[track]], n),
        "fn": _count_causes(series[~track], cause[rows[~track]], n),
        "id_switches": _count_causes(scores.switches.series[switched], switch_cause[switched], n),
    }


def causes_of(counts: CauseCounts, frames: int) -> list[dict[str, Any]]:
    """Errors of each series by cause.

    frames: the number of frames that `counts` are of

    Keys:
    causes: for `fp`, `fn` and `id_switches`, the number of errors in the scored frames by cause
    fn_split, fp_split: objects per frame, summed to `fault`, `attack`, `withheld` (by a defence) and `natural`
    id_switches_split: the same, switches of the whole run
    """
    totals = {"fn": frames, "fp": frames, "id_switches": 1}
    by_error = {
        error: [dict(zip(CAUSES, row, strict=True)) for row in table.tolist()] for error, table in counts.items()
    }
    return [
        {"causes": {error: {name: m for name, m in of_series[k].items() if m} for error, of_series in by_error.items()}}
        | {f"{error}_split": split(by_error[error][k], total) for error, total in totals.items()}
        for k in range(len(counts["fp"]))
    ]


def _count_causes(series: Ints, cause: Ints, n: int) -> Ints:
    """Number of rows with each cause, for each of n series: (n, len(CAUSES))."""
    return np.bincount(series * len(CAUSES) + cause, minlength=n * len(CAUSES)).reshape(n, len(CAUSES))


def split(counts: Mapping[str, int], frames: int) -> dict[str, float | None]:
    """Mean number of rows per frame, by {"fault", "attack", "withheld", "natural"}.

    None without frames.
    counts: rows by cause
    """
    rows = {part: sum(counts.get(cause, 0) for cause in causes) for part, causes in PARTS.items()}
    rows["natural"] = sum(counts.values()) - sum(rows.values())
    return {name: number / frames if frames else None for name, number in rows.items()}
