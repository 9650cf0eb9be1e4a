"""The configurations of the study of the breakdown point."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BreakdownCell:
    """A number of liars among a number of agents, the ego included.

    attack: its short name; "" without liars;  attack_start_s: s of scene time
    """

    attack: str
    agents: int
    liars: int
    attack_start_s: float

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return (
            f"{self.agents} agents {self.attack} {self.liars}" if self.liars else f"{self.agents} agents without liars"
        )
