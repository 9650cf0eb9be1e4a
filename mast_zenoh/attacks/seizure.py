"""An attack on the commands that drivers give their cars."""

from __future__ import annotations

from mast_zenoh.arrays.checks import check
from mast_zenoh.attacks.attack import Attack, ObjectsUnchanged
from mast_zenoh.attacks.campaign import NANOSECONDS


class SeizedCommands(ObjectsUnchanged, Attack):
    """Puts an acceleration of its own in place of the driver's; the car steers as its driver wants.

    A car carries out only what it can do: a command beyond that is refused (`driving.Actuation`).

    acceleration: m/s^2, negative: it brakes
    start_s, end_s: s of scene time; end_s None: 2 s after the start
    """

    def __init__(self, *, acceleration: float = -6.0, start_s: float = 4.0, end_s: float | None = None) -> None:
        check("-1000 to 1000", acceleration=acceleration)
        check("0 or more, finite", start_s=start_s)
        end_s = start_s + 2.0 if end_s is None else end_s
        if not end_s > start_s:
            raise ValueError(f"end_s: found {end_s}, expected more than start_s, {start_s}")
        self._acceleration = acceleration
        self._span_ns = start_s * NANOSECONDS, end_s * NANOSECONDS

    def forge_command(self, time_ns: int, acceleration: float, curvature: float) -> tuple[float, float]:
        begin, end = self._span_ns
        return (self._acceleration if begin <= time_ns < end else acceleration), curvature
