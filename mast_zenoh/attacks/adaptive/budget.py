"""What an attack may spend: lies per second, so that attacks compare at equal cost."""

from __future__ import annotations

#: s for which an unused budget is saved.
SAVED_S = 10.0
#: s for which a lie beyond the steady number must be affordable before it is begun: lies do not flicker.
HOLD_S = 1.0
#: Largest number of lies per second.
MAX_RATE = 10_000.0


class Budget:
    """Decides how many lies are told at once.

    A lie is one object that is inserted, hidden or changed for one second.

    rate: lies per second. So many objects are lied about at all times; what is saved in between allows more

    Raises ValueError for a rate that is not positive or too large.
    """

    def __init__(self, rate: float) -> None:
        if not 0.0 < rate <= MAX_RATE:
            raise ValueError(f"budget: found {rate}, expected more than 0 and at most {MAX_RATE:.0f} lies per second")
        self._rate = rate
        self._saved = 0.0
        self._elapsed_s = 0.0

    def advance(self, elapsed_s: float) -> None:
        """Earn what a message that is `elapsed_s` s after the last one may cost."""
        self._elapsed_s = max(elapsed_s, 0.0)
        self._saved = min(self._saved + self._rate * self._elapsed_s, self._rate * (SAVED_S + self._elapsed_s))

    def admit(self, active: int, wanted: int) -> int:
        """Number of lies in this message, at most `wanted`.

        active: the number of them that have begun
        """
        steady = int(self._rate)
        if self._elapsed_s == 0.0:
            return 0
        affordable = int(self._saved / self._elapsed_s + 1e-9)
        beyond = max(0.0, self._saved - steady * self._elapsed_s)
        most = max(steady, min(active, affordable), steady + int(beyond / HOLD_S))
        return min(wanted, most, affordable)

    def spend(self, lies: int) -> None:
        """Pay for the lies in this message."""
        self._saved -= lies * self._elapsed_s
