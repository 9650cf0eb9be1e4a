"""The configurations of the study of displaced objects."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DriftCell:
    """One liar that displaces one object at a time.

    offset_m: the largest offset;  rate_mps: m/s by which it grows; None: at once
    agents:   number of agents, the ego included
    """

    offset_m: float
    rate_mps: float | None = None
    agents: int = 5

    @property
    def label(self) -> str:
        """The label of its configuration."""
        lie = f"offset {self.offset_m:g} m" if self.rate_mps is None else f"drift {self.rate_mps:g} mps"
        return f"{self.agents} agents {lie}"
