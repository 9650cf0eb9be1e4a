"""How soon a displaced object is noticed, next to the least delay that is possible.

Episodes. An episode is the time for which a displaced object was in view of witnesses, honest agents that see it,
before its liar was suspended. Its clock starts at the first frame in which enough of them see it while it is
displaced, so that nothing was known of it before. It stops when the liar is suspended: a detection. It ends without a
detection (censored) when the object is no longer displaced, when the number of honest viewers leaves the range, or
with the run. Interruptions up to GAP_S do not count, as five returns come and go, and tracks outlive them. When an
episode ends does not depend on the defence, as the attack does not hear of its suspension. So nothing is selected by
leaving out episodes that could not last long enough.

The floor is the least delay with which any detector can notice. The differences between two agents' tracks of one
object have a standard deviation of TRACK_SD_M in each direction, and change so slowly that a second has
INDEPENDENT_PER_S independent ones (both measured on unattacked runs). A sequential test with one false alarm per hour
must collect the logarithm of the number of independent samples in an hour. Each sample of an offset of d metres adds
d^2 / (2 TRACK_SD_M^2) on average. Several witnesses shorten the delay by the cube root of their number. For a drift
this holds if the liar's own track is exact. For a constant offset it is close to the factor 2 J / (J + 1) of J
witnesses and a liar with the same noise: for two to four witnesses, the two differ by 6 % at most.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mast_zenoh.arrays.checks import check
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.study_results import NAN, Row, Statistic
from mast_zenoh.show.findings.words import paragraph
from mast_zenoh.show.number_text import number, percent, whole
from mast_zenoh.show.tables.text_table import ResultTables, numbers_of_rows, shown, table_of_rows
from mast_zenoh.study.defences.kinds import Factors, Kind, few_trials
from mast_zenoh.study.statistics import kaplan_meier, pooled, share_of_trials
from mast_zenoh.study.trial import TrialOutcome

if TYPE_CHECKING:
    from mast_zenoh.runs.run import Run

#: s within which an offset should be detected.
LIMIT_S = 10.0
#: s, longest interruption within an episode.
GAP_S = 0.5
#: Honest viewers from which a majority against the liar is possible: evidence before counts for nobody.
DECISIVE = 2
#: m, standard deviation in each direction of the difference between two honest tracks of one object.
TRACK_SD_M = 0.29
#: Independent differences per second.
INDEPENDENT_PER_S = 1.1
#: One false alarm per hour: what the sum of log-likelihood ratios must reach.
EVIDENCE = math.log(3600.0 * INDEPENDENT_PER_S)
_ROUNDING_S = 1e-6


def _offsets(table: Mapping[str, NDArray[Any]]) -> dict[tuple[int, int], float]:
    """m in the plane by which a track was moved, by frame and id; table: of attacks."""
    rows = np.flatnonzero(np.isin(table["effect"], ("moved", "altered")) & (table["role"] != "link"))
    shift = np.hypot(*(table[f"after_{axis}"][rows] - table[f"before_{axis}"][rows] for axis in "xy"))
    keys = zip(table["frame"][rows].tolist(), table["id"][rows].tolist(), strict=True)
    return dict(zip(keys, np.nan_to_num(shift).tolist(), strict=True))


class ViewerRange(NamedTuple):
    """A range of numbers of honest viewers: at least `least`, at most `most` (None: any number)."""

    least: int
    most: int | None

    @property
    def title(self) -> str:
        """How tables call it."""
        return f"{self.least} or more" if self.most is None else str(self.least)


class Episode(NamedTuple):
    """An object that was displaced in view of witnesses; or a whole run from its first lie on.

    length_s:  for how long, whether the liar was suspended or not; infinite: a whole run
    watched_s: until the suspension, or else `length_s`;  detected: whether the liar was suspended
    speed_up:  mean of `speed_up` over the watched time: one witness alone would need that much longer
    offset_m:  largest offset in the watched time
    """

    length_s: float
    watched_s: float
    detected: bool
    speed_up: float = NAN
    offset_m: float = NAN


#: Two or more: a majority against the liar. One or more: everything that could be noticed at all.
_OPEN_RANGES = (ViewerRange(2, None), ViewerRange(1, None))


def whole_run(measures: Mapping[str, Any]) -> list[Episode]:
    """From the first lie to the suspension, or to the end of the run; [] without a lie."""
    first_s, suspended_s = measures["first_lie_s"], measures["suspended_s"]
    if first_s is None:
        return []
    end_s = measures["end_s"] if suspended_s is None else suspended_s
    return [Episode(math.inf, max(end_s - first_s, 0.0), suspended_s is not None)]


class Drift(Kind):
    """Delays of all trials next to the floor.

    Its factors: offset_m, the largest offset of the only liar; rate_mps, by which it grows, None: at once; agents, the
    ego included
    """

    name = "drift"

    @staticmethod
    def evaluate(run: Run, compromised: Sequence[str]) -> dict[str, Any]:
        """The part `defence` of a trial's metrics.

        first_lie_s, suspended_s: s of scene time, of the only liar; None: never
        end_s:    s, the last frame
        displaced: columns of a row for each displaced track and frame: time_s, track, viewers (honest agents that see
                  the real object), offset_m (in the plane)
        """
        from mast_zenoh.run_folder.tables import from_arrow
        from mast_zenoh.runs.observability import observability  # PyArrow is slow to load

        lies = from_arrow(observability(run).lies)
        moved = np.flatnonzero(np.isin(lies["effect"], ("moved", "altered")))
        offset = _offsets(from_arrow(run.attacks))
        agents = run.files.summary["integrity"]["agents"].values()
        liars = [each for each in agents if each["observed_s"] is not None]  # not those that were suspended before
        if not liars:
            moved = moved[:0]
        first, delay = (liars[0]["first_lie_s"], liars[0]["suspended_after_s"]) if liars else (None, None)
        keys = zip(lies["frame"][moved].tolist(), lies["id"][moved].tolist(), strict=True)
        return {
            "first_lie_s": first,
            "suspended_s": None if delay is None else round(first + delay, 9),
            "end_s": float(from_arrow(run.trust)["time_s"].max()),
            "displaced": {
                "time_s": lies["time_s"][moved].tolist(),
                "track": lies["id"][moved].tolist(),
                "viewers": lies["honest_viewers"][moved].tolist(),
                "offset_m": [round(offset.get(key, 0.0), 6) for key in keys],
            },
        }

    def measures(self, factors: Factors, outcome: TrialOutcome) -> dict[str, Any]:
        """The part `defence` of its metrics."""
        return dict(outcome.metrics["defence"])

    def table(self) -> list[Row]:
        """The rows of all cells: whole runs, then displaced objects by exact number of viewers, and by open ranges.

        Of a row: `viewers` is empty for whole runs, from the first lie to the suspension, regardless of viewers.

        episodes, detected: numbers of displaced objects, and of suspensions among them
        delay_s:  median until the suspension (Kaplan-Meier)
        floor_s:  of the least delay that is possible with as many witnesses;  ratio: median delay in floors
        offset_reached_m: median offset reached before the suspension;  floor_m: offset at the floor
        within:   share of the `judged` runs in which the liar was suspended within LIMIT_S
        noticed:  the same from all episodes (Kaplan-Meier), shorter ones included; unknown if all end before the limit
        """
        rows = []
        for factors, by_trial in self.trials.items():
            trials = list(by_trial.values())
            rows.append(_row(factors, "", [whole_run(each) for each in trials]))
            most = max((max(each["displaced"]["viewers"], default=0) for each in trials), default=0)
            for viewers in (*(ViewerRange(count, count) for count in range(1, most + 1)), *_OPEN_RANGES):
                of_trials = [
                    episodes(**each["displaced"], suspended_s=each["suspended_s"], viewer_range=viewers)
                    for each in trials
                ]
                rows.append(_row(factors, viewers.title, of_trials))
        return rows

    def tables(self, table: Sequence[Row]) -> ResultTables:
        """The CSV has a row for each lie, number of viewers (empty: whole runs) and measure."""
        whole = [row for row in table if not row.of["viewers"]]
        objects = [row for row in table if row.of["viewers"]]
        drifting = [row for row in objects if row.of["rate_mps"] is not None]
        majority = [row for row in objects if row.of["viewers"] == _OPEN_RANGES[0].title]
        lie, viewers = {"lie": "label"}, {"honest viewers": "viewers"}
        tables = [
            table_of_rows(_RUNS, "Whole runs, regardless of viewers.", whole, _OF_RUNS, lie),
            table_of_rows(_OBJECTS, "", objects, _OF_OBJECTS, lie | viewers, texts=2),
            table_of_rows(_OFFSETS, "", drifting, _OF_DRIFTS, {"drift": "label"} | viewers, texts=2),
        ]
        return ResultTables(
            "Displaced objects",
            f"{self.size}. {paragraph('drift_about')}",
            self.size,
            tables if drifting else tables[:-1],
            numbers_of_rows(table),
            [table_of_rows(_MAJORITY, "", majority, _BRIEF, lie)],
            few_trials(row["delay_s"] for row in table),
        )


def _row(factors: Factors, viewers: str, by_trial: Sequence[Sequence[Episode]]) -> Row:
    """A row of whole runs (viewers: ""), or of one range of viewers; by_trial: episodes of each trial, or none."""
    trials = [each for each in by_trial if each]
    every = [episode for each in trials for episode in each]
    offset_m, rate_mps = factors["offset_m"], factors["rate_mps"]
    lie = f"offset {offset_m:g} m" if rate_mps is None else f"drift {rate_mps:g} mps"
    single_s = offset_floor_s(offset_m) if rate_mps is None else drift_floor_s(rate_mps)
    weight = sum(episode.watched_s for episode in every)
    faster = sum(episode.speed_up * episode.watched_s for episode in every) / weight if weight else NAN
    floor_s = single_s / faster if faster else NAN

    def over_episodes(
        of: Callable[[Sequence[tuple[float, bool]]], float], value: Callable[[Episode], float]
    ) -> Statistic:
        def pool(rows: Ints) -> float:
            return of([(value(each), each.detected) for row in rows.tolist() for each in trials[row]])

        return pooled(pool, len(trials))

    # The first object of each trial that lasted long enough: trials are independent, objects of one trial are not.
    long = [[each for each in trial if each.length_s >= LIMIT_S - _ROUNDING_S][:1] for trial in trials]
    judged = [each for trial in long for each in trial]
    within = sum(each.detected and each.watched_s <= LIMIT_S + _ROUNDING_S for each in judged)
    counts = {"episodes": len(every), "detected": sum(each.detected for each in every), "judged": len(judged)}
    numbers = {name: Statistic(float(count), trials=len(trials)) for name, count in counts.items()} | {
        "floor_s": Statistic(floor_s),
        "floor_m": Statistic(NAN if rate_mps is None else floor_s * rate_mps),
        "delay_s": over_episodes(_median, lambda each: each.watched_s),
        "ratio": over_episodes(_median, lambda each: each.watched_s * each.speed_up / single_s)
        if viewers
        else Statistic(),
        "offset_reached_m": over_episodes(_median, lambda each: each.offset_m)
        if viewers and rate_mps is not None
        else Statistic(),
        "within": share_of_trials(within, len(judged)),
        "noticed": over_episodes(_noticed, lambda each: each.watched_s),
    }
    of = {"label": f"{factors['agents']} agents {lie}", "offset_m": offset_m, "rate_mps": rate_mps, "viewers": viewers}
    return Row(of, len(trials), numbers)


def _median(times: Sequence[tuple[float, bool]]) -> float:
    """Median of times, some of them censored: infinite if fewer than half were detected, NaN without any."""
    median = kaplan_meier(*zip(*times, strict=True)).median_s if times else math.nan
    return math.inf if times and math.isnan(median) else median


def _noticed(times: Sequence[tuple[float, bool]]) -> float:
    """Share detected within LIMIT_S, of times of which some are censored; NaN if none was watched for that long."""
    if not times:
        return NAN
    curve = kaplan_meier(*zip(*times, strict=True))
    if curve.time_s[-1] < LIMIT_S - 1e-6 and curve.undetected[-1] > 0.0:
        return NAN
    return 1.0 - float(curve.undetected[curve.time_s <= LIMIT_S + 1e-6][-1])


def episodes(
    time_s: ArrayLike,
    track: ArrayLike,
    viewers: ArrayLike,
    offset_m: ArrayLike,
    suspended_s: float | None,
    viewer_range: ViewerRange,
) -> list[Episode]:
    """The episodes of one run in order of their beginning, at most one for each track of the liar.

    time_s, track, viewers, offset_m: (n,) a row for each displaced track and frame: s, id, honest viewers, and m
    suspended_s: time at which the liar was suspended; None: never. Tracks displaced later are left out.
    """
    times, ids = np.asarray(time_s, np.float64), np.asarray(track)
    seen_by, offset = np.asarray(viewers, np.int64), np.asarray(offset_m, np.float64)
    end_s = math.inf if suspended_s is None else suspended_s
    result = []
    for each in dict.fromkeys(ids.tolist()):
        rows = np.flatnonzero(ids == each)
        rows = rows[np.argsort(times[rows], kind="stable")]
        period = _period(times, rows, seen_by[rows], viewer_range)
        if period is not None and times[period[0]] < end_s - _ROUNDING_S:
            result.append((float(times[period[0]]), _episode(times[period], seen_by[period], offset[period], end_s)))
    return [episode for _, episode in sorted(result, key=lambda pair: pair[0])]


def _period(times: Floats, rows: Ints, seen_by: Ints, viewer_range: ViewerRange) -> Ints | None:
    """The rows of a track's episode; None if it has none, or was known before."""
    inside = seen_by >= viewer_range.least
    if viewer_range.most is not None:
        inside &= seen_by <= viewer_range.most
    if not inside.any():
        return None
    first = int(inside.argmax())
    if (seen_by[:first] >= min(DECISIVE, viewer_range.least)).any():
        return None
    last = first
    for index in (np.flatnonzero(inside[first + 1 :]) + first + 1).tolist():
        if times[rows[index]] - times[rows[last]] > GAP_S + _ROUNDING_S:
            break
        last = index
    return rows[first : last + 1]


def _episode(times: Floats, seen_by: Ints, offset: Floats, end_s: float) -> Episode:
    length_s = float(times[-1] - times[0])
    detected = bool(end_s <= times[-1] + _ROUNDING_S)
    watched = times <= end_s + _ROUNDING_S
    return Episode(
        round(length_s, 9),
        round(float(end_s - times[0]) if detected else length_s, 9),
        detected,
        float(speed_up(seen_by[watched]).mean()),
        float(offset[watched].max()),
    )


def offset_floor_s(offset_m: float) -> float:
    """s until one witness can know of a constant offset; raises ValueError unless it is positive."""
    check("more than 0, finite", offset_m=offset_m)
    return EVIDENCE / (INDEPENDENT_PER_S * offset_m**2 / (2.0 * TRACK_SD_M**2))


def drift_floor_s(rate_mps: float) -> float:
    """s until one witness can know of an offset that grows by `rate_mps`; raises ValueError unless it is positive.

    The evidence after t s is the integral of that of the offset: INDEPENDENT_PER_S rate^2 t^3 / (6 TRACK_SD_M^2).
    """
    check("more than 0, finite", rate_mps=rate_mps)
    return math.cbrt(6.0 * TRACK_SD_M**2 * EVIDENCE / (INDEPENDENT_PER_S * rate_mps**2))


def speed_up(witnesses: ArrayLike) -> Floats:
    """(...) factor by which several witnesses shorten the delay; 0 without any, as nobody can ever know."""
    factor: Floats = np.cbrt(np.asarray(witnesses, np.float64))
    return factor


# -- what readers see --------------------------------------------------------------------------------------------------

_RUNS = "From the first lie to the suspension"
_OFFSETS = "Offset that a drift reaches"
_OBJECTS = "For each displaced object, by the number of honest agents that see it"
_MAJORITY = "Displaced objects in view of two honest agents or more, until the liar is suspended"
_WITHIN = f"within {LIMIT_S:g} s"


def _share(each: Statistic) -> str:
    return percent(each, " %")


def _plain(each: Statistic) -> str:
    return number(each.value)


def _share_of_judged(row: Row) -> str:
    return _share(row["within"]) + (f" of {whole(row['judged'])}" if row["within"].known else "")


_COUNTED = {"runs": lambda row: str(row.trials)}
_OF_RUNS = {
    **_COUNTED,
    "suspended": shown("detected", whole),
    "median delay (s)": shown("delay_s"),
    _WITHIN: shown("within", _share),
}
_FLOORS = {
    "floor (s)": shown("floor_s", _plain),
    "delay / floor": shown("ratio"),
    _WITHIN: _share_of_judged,
}
_OF_OBJECTS = {
    "objects": shown("episodes", whole),
    **_COUNTED,
    "detected": shown("detected", whole),
    "median delay (s)": shown("delay_s"),
    **_FLOORS,
    f"{_WITHIN} (Kaplan-Meier, all episodes)": shown("noticed", _share),
}
_OF_DRIFTS = {
    "median offset (m)": shown("offset_reached_m"),
    "at the floor (m)": shown("floor_m", _plain),
}
_BRIEF = {
    "detected": lambda row: f"{whole(row['detected'])} of {whole(row['episodes'])}",
    "delay (s)": shown("delay_s"),
    **_FLOORS,
}
