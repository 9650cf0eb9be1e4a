"""The measured effects as columns of attacks.parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mast_zenoh.effects import EFFECTS, Effects
from mast_zenoh.effects.reports import Agreement
from mast_zenoh.metrics import Table


def attacks(effects: Effects, agreement: Agreement, roles: Mapping[str, str], period_s: float) -> Table:
    """The effects as columns of attacks.parquet.

    Sorted by interposer, wire, frame and sequence number.
    Objects of a message that was withheld, forged or reframed as a whole have no separate rows.
    """
    rows = np.flatnonzero(~effects.whole)
    passages = effects.passages
    passage_row = effects.passage[rows]

    def of_passage(values: Sequence[str]) -> np.ndarray:
        return np.array([*values, ""], object)[passage_row] if len(rows) else np.zeros(0, object)

    delay_ns = effects.frames_late[rows] * period_s * 1e9 + effects.time_ns[rows]
    return {
        "interposer": of_passage([passage.node for passage in passages]),
        "role": of_passage([roles.get(passage.node, "") for passage in passages]),
        "wire": of_passage([passage.wire for passage in passages]),
        "message": of_passage([passage.message for passage in passages]),
        "before_subscriber": of_passage([passage.before for passage in passages]),
        "frame": effects.frame[rows],
        "seq": effects.seq[rows],
        "effect": np.array(EFFECTS, object)[effects.code[rows]],
        "id": effects.id[rows],
        **{f"before_{axis}": effects.before[rows, i] for i, axis in enumerate("xyz")},
        **{f"after_{axis}": effects.after[rows, i] for i, axis in enumerate("xyz")},
        **{f"v{axis}": effects.velocity[rows, i] for i, axis in enumerate("xyz")},
        "columns": effects.columns[rows],
        "delay_s": np.where(delay_ns != 0, delay_ns * 1e-9, np.nan),
        "reported": agreement.reported[rows],
        "label": agreement.label[rows],
    }
