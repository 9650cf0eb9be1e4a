"""Which frames and times the messages of a run can have: what lies outside is rejected on arrival."""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh.messages.schemas import Header

#: s, by which a time may be wrong though no node says that it changes times (`Node.restamps_s`): an adversary's small
#: shift does harm, and is to; messages that are off by more are of no use to any shipped node.
LEEWAY_S = 1.0


class Timespan(NamedTuple):
    """The frames of a run and their times.

    frames:    how many there are
    period_ns: ns, from one to the next
    leeway_ns: ns, by how much the time in a header may be wrong in this run: clock faults, uneven frames, LEEWAY_S
    """

    frames: int
    period_ns: int
    leeway_ns: int

    def refusal(self, header: Header, step: int) -> str:
        """Why a message cannot be one of the run, or ""; step: the frame that the run is at, -1 where it is unknown.

        A message is about a frame of the run that has begun. Its time is between that of its frame and that of `step`.
        Either may be off by the leeway.
        """
        _, _, frame, time_ns, _ = header
        frames, period_ns, leeway_ns = self
        if frame <= step < frames and time_ns == frame * period_ns:
            return ""  # nearly all are
        latest = frames - 1 if step < 0 else min(step, frames - 1)
        if (frame - latest) * period_ns > leeway_ns:
            expected = f"at most {latest + leeway_ns // period_ns}"
            return f"frame: {header.schema}: frame is {frame}, expected {expected}"
        least, most = frame * period_ns - leeway_ns, max(frame, step) * period_ns + leeway_ns
        if not least <= time_ns <= most:
            return f"time: {header.schema}: time_ns is {time_ns}, expected {max(0, least)} to {most} of frame {frame}"
        return ""
