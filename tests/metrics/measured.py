"""Synthetic measured effects, and the causes of errors that follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.effects import Effects
from mast_zenoh.effects.table import CODE
from mast_zenoh.evaluation.from_effects import manipulations
from mast_zenoh.metrics import AttributionLimits, Attributor, Record, Scorer, Scores, cause_names
from mast_zenoh.wiring.model import Passage

PERIOD_S = 0.1
#: Interposer, frame, effect, id of the object in the message, its position (removed: original; inserted, moved: new)
#: and its velocity; of a moved object instead its original position.
Row = tuple[str, int, str, int, tuple[float, float], tuple[float, float]]


def passage(node: str, port: str = "tracks", subject: str = "infra_9", before: str = "") -> Passage:
    """The position of an interposer on a wire."""
    return Passage(node, f"agent/{subject}/{port}", subject, port, port, f"{port}/in", f"{port}/out", before)


def effects(*rows: Row, passages: Sequence[Passage] = (), of: Sequence[int] | None = None) -> Effects:
    """Effects on objects. passages, of: their wires, by default of tracks."""
    nodes = sorted({row[0] for row in rows})
    ways = tuple(passages) or tuple(passage(node) for node in nodes)
    n = len(rows)
    before, after, velocity = (np.full((n, 3), np.nan) for _ in range(3))
    for k, (_, _, effect, _, where, more) in enumerate(rows):
        if effect in ("removed", "altered"):
            before[k] = [*where, 0.0]
        if effect != "removed":
            after[k] = [*where, 0.0]
        if effect == "moved":
            before[k], velocity[k] = [*more, 0.0], 0.0
        else:
            velocity[k] = [*more, 0.0]
    return Effects(
        passages=ways,
        received=(0,) * len(ways),
        passage=np.array([nodes.index(row[0]) for row in rows] if of is None else of, np.int64),
        code=np.array([CODE[row[2]] for row in rows], np.int64),
        frame=np.array([row[1] for row in rows], np.int64),
        seq=np.array([row[1] for row in rows], np.int64),
        step=np.array([row[1] for row in rows], np.int64),
        id=np.array([row[3] for row in rows], np.int64),
        before=before,
        after=after,
        velocity=velocity,
        whole=np.zeros(n, bool),
        frames_late=np.zeros(n, np.int64),
        time_ns=np.zeros(n, np.int64),
        columns=np.array([""] * n, object),
    )


def explained(record: Record, measured: Effects, roles: dict[str, str] | None = None, **more) -> dict[str, np.ndarray]:
    """The table of objects of a record with causes; more: see `Attributor`."""
    return labelled(record, measured, roles, **more)[1]


def labelled(record: Record, measured: Effects, roles: dict[str, str] | None = None, **more):
    """(scores, table of objects with causes, labels, manipulations) of a record."""
    scores: Scores = Scorer().score(record)
    truth = record.truth(scores.frames)
    boxes = truth.boxes.in_group(scores.frames[truth.boxes.group])
    known = {way.node: "adversary" for way in measured.passages} | (roles or {})
    done = manipulations(
        measured, known, scores.series, boxes, PERIOD_S, np.zeros(len(measured), bool), AttributionLimits()
    )
    labels = Attributor(AttributionLimits(), scores, done, truth, record.agents, PERIOD_S, **more).labels()
    return scores, scores.objects() | {"cause": cause_names(labels.cause), "by": labels.by}, labels, done
