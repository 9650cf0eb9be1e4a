"""The errors of a panel over time, with bands for attacks, faults and interceptions, and a line at the frame shown."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, NullLocator

from mast_zenoh.report.film.attacks import Attacks
from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.film.theme import Theme
from mast_zenoh.report.playback.conduct import spans


class Strip:
    """Missed and false objects over the time of the film.

    changing: the artists that differ from frame to frame;  most: the greatest number of objects in a scored frame
    """

    def __init__(self, axes: Axes, take: Take, attacks: Attacks, limits: tuple[float, float], theme: Theme) -> None:
        self.axes = axes
        low, high = limits
        axes.set_xlim(low, max(high, low + 1e-3))
        axes.set_facecolor(theme.ground)
        axes.tick_params(colors=theme.faint, labelsize=8, length=2, pad=1.5)
        axes.xaxis.set_major_locator(MaxNLocator(8))
        axes.xaxis.set_major_formatter("{x:g} s")
        axes.yaxis.set_major_locator(MaxNLocator(2, integer=True))
        for side, spine in axes.spines.items():
            spine.set_visible(side in ("left", "bottom"))
            spine.set_color(theme.building_edge)
        self._draw_bands(take, attacks, theme)
        series = take.series()
        self.most = 1.0
        if series is not None:
            times, missed, false = series
            inside = (times >= low - 1e-6) & (times <= high + 1e-6)
            # The axis fits the scored frames: before them, everything is missed.
            first, last = (take.seconds(frame) for frame in take.run.scored_frames or (take.first, take.last))
            scored = inside & (times >= first - 1e-6) & (times <= last + 1e-6)
            scored = scored if scored.any() else inside
            for values, outcome in ((missed, "truth missed"), (false, "track false")):
                axes.plot(times[inside], values[inside], color=theme.outcomes[outcome], linewidth=1.3, zorder=3)
                self.most = max(self.most, *values[scored].tolist())
        else:
            axes.yaxis.set_major_locator(NullLocator())
        self.set_most(self.most)
        self._now = axes.axvline(low, color=theme.ink, linewidth=1.4, zorder=4)
        self.changing: list[Artist] = [self._now]

    def _draw_bands(self, take: Take, attacks: Attacks, theme: Theme) -> None:
        period = take.run.period_s
        for start, end in attacks.spans:
            self.axes.axvspan(
                take.seconds(start), take.seconds(end - 1) + period, color=theme.adversary, alpha=0.28, lw=0
            )
        for each in spans(take.run, np.array([take.seconds(frame) for frame in range(take.last + 1)])):
            if each["kind"] == "fault":
                self.axes.axvspan(each["from_s"], each["until_s"], color=theme.fault, alpha=0.25, lw=0)
            elif each["kind"] == "interception":
                for edge in (each["from_s"], each["until_s"]):
                    self.axes.axvline(edge, color=theme.adversary, linewidth=1.2, linestyle=(0, (3, 2)), zorder=2)

    def set_most(self, most: float) -> None:
        """Set the greatest number of objects on the axis."""
        self.axes.set_ylim(-0.04 * most, 1.12 * most)

    def show(self, seconds: float) -> None:
        """Move the line to a time, s."""
        self._now.set_xdata([seconds, seconds])
