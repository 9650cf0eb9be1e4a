"""The faults of the run whose command centre judges agents."""

from __future__ import annotations

from typing import Any

LOSS_S = (2.0, 3.0)
FAULTS: list[dict[str, Any]] = [
    dict(type="Loss", at=LOSS_S[0], until=LOSS_S[1], node="infra_2", probability=0.5),
    dict(type="Delay", at=2.0, node="infra_3", mean_s=0.1, direction="down"),
]
