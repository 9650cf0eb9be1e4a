"""The cells of studies of defences, which study files import: their kinds load more."""

from __future__ import annotations

from dataclasses import dataclass

from mast_zenoh.study.defences.kinds import DefenceCell


@dataclass(frozen=True, slots=True)
class CooperationCell(DefenceCell):
    """A fusion architecture and a number of agents, the ego included.

    attacked: whether some of them lie;  attack_start_s: s of scene time, from which trials count, with lies or without
    """

    kind = "cooperation"

    architecture: str
    agents: int
    attacked: bool
    attack_start_s: float

    @property
    def label(self) -> str:
        """The label of its configuration."""
        return f"{self.architecture} {self.agents} agents{' attacked' if self.attacked else ''}"
