"""Which of the commands that arrive a car carries out: the newest; without one it holds on, then it brakes."""

from __future__ import annotations

from collections import Counter

from mast_zenoh.driving.motion import CarLimits, Command

#: s, until which a world's cars drive as in the prepared scene, and for which a car without commands goes on as it was
#: told, if a scenario says nothing else.
TAKE_OVER_S, HOLD_S = 1.0, 0.3


class Actuation:
    """What one car does with the commands that it gets.

    A command of a frame acts in the next one. If that one has no command, because it is late, lost or refused, the car
    goes on as the newest command said, for at most `hold_frames` frames; then it brakes along its last curvature,
    until a newer command arrives. A late command acts when it arrives, if it is new enough to be held.

    limits: of the car; braking: m/s^2, of a car without commands, if it can
    counts: of frames, by what the car did: "commanded", "held", "braked"; and of refused commands, "refused"
    """

    def __init__(self, limits: CarLimits, hold_frames: int, braking: float) -> None:
        self.limits, self.hold_frames, self.braking = limits, hold_frames, min(braking, limits.braking)
        self.counts: Counter[str] = Counter(commanded=0, held=0, braked=0, refused=0)
        self._newest: tuple[int, Command] | None = None

    def receive(self, frame: int, now: int, command: Command) -> str:
        """Take a command of a frame; returns the reason why it is refused, or "". now: the current frame"""
        reason = self._refusal(frame, now, command)
        if reason:
            self.counts["refused"] += 1
        else:
            self._newest = frame, command
        return reason

    def _refusal(self, frame: int, now: int, command: Command) -> str:
        if frame > now:
            return f"early: command of frame {frame}, which has not begun"
        if self._newest is not None and frame <= self._newest[0]:
            return f"old: command of frame {frame} after that of frame {self._newest[0]}"
        return self.limits.refusal(command)

    def obeyed(self, frame: int) -> int:
        """The frame whose command the car carries out from the frame before until `frame`; -1: of none, it brakes."""
        if self._newest is None or frame - 1 - self._newest[0] > self.hold_frames:
            return -1
        return self._newest[0]

    def act(self, frame: int) -> Command:
        """What the car does from the frame before until `frame`."""
        _, newest = self._newest or (-1, Command(0.0, 0.0))
        sent = self.obeyed(frame)
        if sent < 0:
            self.counts["braked"] += 1
            return Command(-self.braking, newest.curvature)
        self.counts["held" if sent < frame - 1 else "commanded"] += 1
        return newest
