"""Whether an assessment of a stage is one."""

from __future__ import annotations

import numpy as np

from mast_zenoh.integrity.base import STATES, Assessment

_AGENTS = {"mean": (), "log_odds": (), "state": (), "offset": (2,), "turn": (), "delay": (), "loss": ()}
_COUNTS = ("expected", "confirming", "contradicting")


def problem_of(assessment: Assessment, n: int, a: int, c: int) -> str:
    """What is wrong with an assessment of n tracks of a agents in c clusters; "" if nothing is."""
    weights, agents, objects = assessment.weights, assessment.agents, assessment.objects
    columns = {
        **{f"agents.{name}": (getattr(agents, name), (a, *more)) for name, more in _AGENTS.items()},
        **{f"objects.{name}": (getattr(objects, name), (c,)) for name in ("trust", *_COUNTS, "withheld")},
    }
    if weights is not None:
        columns["weights"] = weights, (n,)
    for name, (values, shape) in columns.items():
        if values.shape != shape:
            return f"{name} has the shape {values.shape}, expected {shape}"
        if values.dtype.kind == "f" and not np.isfinite(values.sum()):
            return f"{name} has numbers that are not finite"
    if weights is not None and (weights < 0.0).any():
        return "a weight is below 0"
    if len(agents.reason) != a:
        return f"found {len(agents.reason)} reasons, expected {a}"
    if (agents.state >= len(STATES)).any():
        return "a state is not an index into STATES"
    for name, values in (("agents.mean", agents.mean), ("objects.trust", objects.trust)):
        if len(values) and not 0.0 <= values.min() <= values.max() <= 1.0:
            return f"{name} is not from 0 to 1"
    for name in _COUNTS:
        counts = getattr(objects, name)
        if counts.dtype != np.int64:
            return f"objects.{name} is {counts.dtype}, expected int64"
        if len(counts) and not 0 <= counts.min() <= counts.max() <= a:
            return f"objects.{name} is not from 0 to {a}, all agents"
    if objects.withheld.dtype != np.bool_:
        return f"objects.withheld is {objects.withheld.dtype}, expected bool"
    return ""
