"""Whether each agent was honest, faulty or lying at each time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.arrays.states import Bools, Floats

#: How an agent behaves. An agent that is both faulty and lying is lying.
CONDUCT = ("honest", "faulty", "lying")
HONEST, FAULTY, LYING = range(3)

#: A fault of an agent: its type, and its beginning and end in s of scene time (None: the end of the run).
Fault = tuple[str, float, float | None]


@dataclass(frozen=True, slots=True, eq=False)
class Conduct:
    """How a agents behaved over f frames.

    lies:   (f, a) whether an adversary changed what the agent sent about this frame
    faults: (f, a) whether a fault acted on the agent
    lasting_frames: frames for which a lie or a fault counts after its own, because tracks outlive their objects
    """

    lies: Bools
    faults: Bools
    lasting_frames: int = 0

    @property
    def kind(self) -> NDArray[np.int64]:
        """(f, a) index into CONDUCT."""
        faulty, lying = lasting(self.faults, self.lasting_frames), lasting(self.lies, self.lasting_frames)
        return np.where(lying, LYING, np.where(faulty, FAULTY, HONEST))


def lasting(events: Bools, frames: int) -> Bools:
    """(f, a) whether an event happened in a frame or in the `frames` before it.

    events: (f, a)
    """
    index = np.arange(len(events))[:, None]
    latest = np.maximum.accumulate(np.where(events, index, -1 - frames - len(events)), axis=0)
    return np.asarray(index - latest <= frames)


def fault_frames(faults: Mapping[str, Sequence[Fault]], agents: Sequence[str], times_s: Floats) -> Bools:
    """(f, a) whether any fault acted on an agent.

    faults: by agent; times_s: (f,) s of each frame
    """
    result = np.zeros((len(times_s), len(agents)), bool)
    for index, agent in enumerate(agents):
        for _, at_s, until_s in faults.get(agent, ()):
            result[:, index] |= (times_s >= at_s) & (times_s < (np.inf if until_s is None else until_s))
    return result
