"""The scores of a run: tables per frame and per object, and the summary that goes into metrics.json."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mast_zenoh.states import Floats, Ints

#: A table: one array per column, all of one length.
Table = dict[str, NDArray[Any]]

#: What became of a box, by the code used in `scoring`.
OUTCOMES = ("matched", "missed", "false", "unevaluated")
MATCHED, MISSED, FALSE, UNEVALUATED = range(len(OUTCOMES))


@dataclass(frozen=True, slots=True)
class Scores:
    """Counts of s series (an agent and one of its estimators) in f frames.

    series:        s pairs (agent, estimator)
    frames:        (f,) int64
    fn, fp, tp:    (s, f) int64
    squared_error: (s, f) m^2, summed over the pairs of the frame
    id_switches:   (s, f) int64
    objects:       a row per box and series, columns frame, agent, estimator, kind ("truth" | "track"), outcome
                   ("matched" | "missed" | "false" | "unevaluated"), id, match_id (-1: none), x, y, z, l, w, h, yaw
                   and score (NaN for truth): what the figures show, objects in range that are not evaluated included
    """

    series: tuple[tuple[str, str], ...]
    frames: Ints
    fn: Ints
    fp: Ints
    tp: Ints
    squared_error: Floats
    id_switches: Ints
    objects: Table

    def per_frame(self) -> Table:
        """A row per series and frame: frame, agent, estimator, fn, fp, tp, rmse_m (NaN without a pair), id_switches."""
        s, f = len(self.series), len(self.frames)
        error = np.divide(self.squared_error, self.tp, out=np.full((s, f), np.nan), where=self.tp > 0)
        return {
            "frame": np.tile(self.frames, s),
            "agent": np.repeat(np.array([agent for agent, _ in self.series], str), f),
            "estimator": np.repeat(np.array([estimator for _, estimator in self.series], str), f),
            "fn": self.fn.ravel(),
            "fp": self.fp.ravel(),
            "tp": self.tp.ravel(),
            "rmse_m": np.sqrt(error).ravel(),
            "id_switches": self.id_switches.ravel(),
        }

    def summary(self, scored: slice = slice(None)) -> dict[str, dict[str, dict[str, Any]]]:
        """By agent and estimator: fn, fp, tp as {"mean", "std"} over frames, rmse_m over all pairs, id_switches in all.

        scored: which of `self.frames` count, such as all but those in which tracks have only begun. The standard
        deviation is that of the frames themselves (divided by their number). What is not defined, without frames or
        without pairs, is None, so that JSON holds null.
        """
        result: dict[str, dict[str, dict[str, Any]]] = {}
        for k, (agent, estimator) in enumerate(self.series):
            pairs = int(self.tp[k, scored].sum())
            result.setdefault(agent, {})[estimator] = {
                **{name: mean_and_std(getattr(self, name)[k, scored]) for name in ("fn", "fp", "tp")},
                "rmse_m": float(np.sqrt(self.squared_error[k, scored].sum() / pairs)) if pairs else None,
                "id_switches": int(self.id_switches[k, scored].sum()),
            }
        return result


def mean_and_std(values: NDArray[Any]) -> dict[str, float | None]:
    """Mean and standard deviation of (n,) values; None of none."""
    if len(values) == 0:
        return {"mean": None, "std": None}
    return {"mean": float(np.mean(values)), "std": float(np.std(values))}
