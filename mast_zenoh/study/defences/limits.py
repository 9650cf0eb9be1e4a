"""The configurations of the studies of limits: how a displaced object is noticed, and where a defence breaks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class DriftCell:
    """One liar that displaces one object at a time.

    offset_m: the largest offset;  rate_mps: m/s by which it grows; None: at once
    """

    evaluation: ClassVar[str] = "drift"

    offset_m: float
    rate_mps: float | None = None

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return f"offset {self.offset_m:g} m" if self.rate_mps is None else f"drift {self.rate_mps:g} mps"


@dataclass(frozen=True, slots=True)
class BreakdownCell:
    """A number of liars among a number of agents, the ego included.

    attack: its short name; "" without liars;  attack_start_s: s of scene time
    """

    evaluation: ClassVar[str] = "breakdown"

    attack: str
    agents: int
    liars: int
    attack_start_s: float

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return f"{self.agents} agents {self.attack} {self.liars}" if self.liars else f"{self.agents} agents alone"
