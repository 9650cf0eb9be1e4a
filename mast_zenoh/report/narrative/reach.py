"""Determines which estimates an interposer can influence from its wires."""

from __future__ import annotations

import numpy as np

from mast_zenoh.evaluation.downstream import influence
from mast_zenoh.report.runfolder import RunFolder, agent_of
from mast_zenoh.report.tables.wiring import all_wires
from mast_zenoh.wiring.model import Passage


def reaches(run: RunFolder, node: str, estimate: str, agent: str | None = None) -> bool:
    """Whether a node's messages can affect an estimate of an agent.

    agent: by default the ego

    True if its wires are not known.
    """
    passages = _passages(run, node)
    series = [(agent or run.ego or "", estimate)]
    return not passages or bool(influence(passages, series, np.zeros(len(passages), bool)).any())


def _passages(run: RunFolder, node: str) -> list[Passage]:
    """Its passages through all wires that it was ever on, including live insertions."""
    passages = []
    for wire in all_wires(run):
        if node not in wire.get("interposers", ()):
            continue
        key, legs = wire["key"], wire.get("legs", ())
        port = (legs[0].get("from_port") if legs else None) or wire.get("message", "")
        befores = {leg["before"]: None for leg in legs if leg.get("from") == node and leg.get("before")}
        subject = wire.get("subject") or agent_of(key) or ""
        passages += [
            Passage(node, key, subject, wire.get("message", ""), port, "", "", each) for each in befores or [""]
        ]
    return passages
