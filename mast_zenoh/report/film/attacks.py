"""When attacks are on, and what they do in a frame, as measured on the wires."""

from __future__ import annotations

from collections import Counter

import numpy as np

from mast_zenoh.report.files import rows
from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.interposers import interposers

#: s: an attack that changes nothing for so long is over.
_PAUSE_S = 1.0
#: Adversaries or agents that are named; more are counted.
_NAMED = 2


class Attacks:
    """The attacks of a run.

    spans: first frame and the frame after the last of each period with changes by adversaries
    """

    def __init__(self, run: RunFolder) -> None:
        self._effects = run.attacks
        frames = np.unique(run.attacks["frame"]).astype(np.int64) if run.attacks is not None else np.zeros(0, np.int64)
        breaks = np.flatnonzero(np.diff(frames) * run.period_s > _PAUSE_S)
        parts = np.split(frames, breaks + 1) if len(frames) else []
        self.spans = [(int(part[0]), int(part[-1]) + 1) for part in parts]
        self._interposers = [each for each in interposers(run) if not each.is_link]

    def on(self, frame: int) -> bool:
        """Whether an attack is on in a frame."""
        return any(start <= frame < end for start, end in self.spans)

    def attacked(self, frame: int) -> set[str]:
        """The agents on whose wires an adversary sits in a frame."""
        present = [
            each
            for each in self._interposers
            if (each.live is None or each.live <= frame) and (each.released is None or frame < each.released)
        ]
        return {agent for each in present for agent in (*each.agents, *each.before)}

    @property
    def possible(self) -> bool:
        """Whether any adversary is ever on a wire."""
        return bool(self._interposers)

    def sentence(self, frame: int) -> str:
        """What is done in a frame, in words."""
        if self._effects is None:
            return "attacks were not measured" if self.possible else "no attack"
        if not self.on(frame):
            waiting = self.attacked(frame)
            return (
                f"no attack; adversary on the wires of {_names(sorted(waiting), 'agents')}" if waiting else "no attack"
            )
        here = rows(self._effects, self._effects["frame"] == frame)
        changes = Counter(here["effect"].astype(str).tolist())
        names = sorted(set(here["interposer"].astype(str).tolist()))
        what = ", ".join(f"{count} {effect}" for effect, count in sorted(changes.items()))
        return f"attack by {_names(names, 'adversaries')}: {what}" if names else "attack: nothing changed in this frame"


def _names(names: list[str], noun: str) -> str:
    return ", ".join(names) if len(names) <= _NAMED else f"{len(names)} {noun}"
