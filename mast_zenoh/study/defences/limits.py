"""The configurations of the studies of limits: how a displaced object is noticed, and where a defence breaks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from mast_zenoh.errors import ConfigurationError

#: Up to so many agents, all but the ego stand on poles.
_POLES_ALONE = 5
_MOST_AGENTS = 29


@dataclass(frozen=True, slots=True)
class DriftCell:
    """One liar that displaces one object at a time.

    offset_m: the largest offset;  rate_mps: m/s by which it grows; None: at once
    agents:   number of agents, the ego included
    """

    evaluation: ClassVar[str] = "drift"

    offset_m: float
    rate_mps: float | None = None
    agents: int = 5

    @property
    def label(self) -> str:
        """The label of its configuration."""
        lie = f"offset {self.offset_m:g} m" if self.rate_mps is None else f"drift {self.rate_mps:g} mps"
        return f"{self.agents} agents {lie}"


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


def sensors_of(agents: int) -> dict[str, int]:
    """The parameters of a generated junction with this number of agents, the ego included.

    Poles, and above five agents cars, too: 8 and 4 for 13 agents, 12 and 8 for 21. Raises ConfigurationError for a
    number of agents that a junction cannot have.
    """
    if type(agents) is not int or not 2 <= agents <= _MOST_AGENTS:
        raise ConfigurationError(f"agents: found {agents!r}, expected whole numbers from 2 to {_MOST_AGENTS}")
    cars = max(0, (agents - _POLES_ALONE) // 2)
    return {"n_infrastructure": agents - 1 - cars, "n_mobile": cars}
