"""What the tracks of one agent have shown of its fault."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.integrity.cumulative import MAX_STEP_S, SAMPLES_PER_S
from mast_zenoh.integrity.fault_fit import NOTHING, Displacements, explained, misfit, solved

#: Mean of Huber's loss of a displacement up to which a fit is good.
FIT = 1.2
#: Difference of the sums of Huber's loss from which a batch shows another fault than those before.
CHANGED = 5.0


@dataclass(slots=True)
class FaultEstimate:
    """Sums and fault of one agent.

    time_ns: ns, of the last fit, or of the first batch
    fault: see `faults`; statistic: twice the log-likelihood that it gains
    share: of the tracks in the last fit that the fault explains; others: agents that reported them, too
    applied: whether the agent's tracks are corrected
    excused_until_ns: ns, until when no further fault excuses what the agent did before it was found
    loss: 0 to 1, share of frames in which nothing of the agent arrived
    """

    time_ns: int
    information: Floats = field(default_factory=lambda: np.zeros((4, 4)))
    score: Floats = field(default_factory=lambda: np.zeros(4))
    fault: Floats = field(default_factory=lambda: np.zeros(4))
    statistic: float = 0.0
    share: float = 0.0
    others: int = 0
    applied: bool = False
    excused_until_ns: int = 0
    loss: float = 0.0

    @property
    def known(self) -> Floats:
        """(4,) the fault that is corrected; zeros: none."""
        return self.fault * self.applied

    def update(self, time_ns: int, found: Displacements, memory_s: float) -> None:
        """Add the displacements of a batch. memory_s: s, after which they count 1/e"""
        elapsed_s = (time_ns - self.time_ns) * 1e-9
        samples = SAMPLES_PER_S * min(elapsed_s, MAX_STEP_S)
        keep = np.exp(-elapsed_s / memory_s)
        self.time_ns = time_ns
        past = keep * self.information, keep * self.score
        fault, total = solved(found, samples, past, self.fault, self.known)
        self.others = found.others
        if self.others and misfit(found, fault) > FIT * len(found.offset):
            # What was known does not explain this batch. It may be a new fault: fitted to this batch alone.
            anew, sums = solved(found, samples, NOTHING, None, np.zeros(4), steps=3)
            if misfit(found, anew) < misfit(found, fault) - CHANGED:
                fault, total = anew, sums
        self.fault, (self.information, self.score) = fault, total
        self.statistic = float(self.score @ fault)
        self.share = explained(found, fault)

    def forget(self) -> None:
        """Forget the sums, but not a fault that is corrected."""
        self.fault = self.known
        self.information, self.score = NOTHING
        self.statistic = 0.0
