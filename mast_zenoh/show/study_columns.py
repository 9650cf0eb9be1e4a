"""The measures of a study that tables compare and sentences name, by heading."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from mast_zenoh.metrics.estimates import ESTIMATES, MAIN
from mast_zenoh.metrics.measures import MEASURES
from mast_zenoh.metrics.study_results import Row, StudySeries

#: The warning of a table with such an increment.
MOSTLY_ZERO_NOTE = (
    'Warning: "(0 in N % [a, b])" marks a difference that is 0 in N % of the trials; a to b is the exact 95 % interval '
    "of that share. The mean has no interval: it would be too narrow."
)


#: Columns of a table, a measure by heading, in groups with a name.
Groups = tuple[tuple[str, Mapping[str, StudySeries]], ...]

#: The estimates of the ego that tables compare, and their names.
ESTIMATORS = {name: ESTIMATES[name].subject.removeprefix("the ") for name in MAIN}

_SCORES = ("fn", "fp", "tp", "rmse_m", "id_switches")
_DISTANCES = ("ospa_m", "gospa_m", "completeness")
_BOXES = ("length_error_m", "width_error_m", "heading_error_deg", "velocity_error_mps")


def _of(estimator: str, metrics: Iterable[str], suffix: str = "") -> dict[str, StudySeries]:
    return {MEASURES[metric].short: StudySeries("", estimator, metric + suffix) for metric in metrics}


#: The scores of each estimate, and their increments over the baseline.
SCORES: Groups = tuple((name, _of(estimator, _SCORES)) for estimator, name in ESTIMATORS.items())
ALL_SCORES: Groups = tuple(
    (name, _of(estimator, (*_SCORES, *_DISTANCES, *_BOXES, "iou_3d"))) for estimator, name in ESTIMATORS.items()
)
ADDED: Groups = tuple((name, _of(estimator, _SCORES + _BOXES, "_iob")) for estimator, name in ESTIMATORS.items())


def _of_all(estimator: str, columns: Mapping[str, str], owner: str = "all") -> dict[str, StudySeries]:
    """Metrics by heading, of all agents or adversaries together."""
    return {heading: StudySeries(owner, estimator, metric) for heading, metric in columns.items()}


_COMPROMISED = (
    ("local", "compromised agents", "CAFN IoB", "CAFP IoB"),
    ("picture", "compromised agents, by the centre", "CAFN centre", "CAFP centre"),
)
#: The increments by their names in the paper.
PAPER: Groups = (
    *(
        (name, _of_all(estimator, {fn: "cafn_iob", fp: "cafp_iob"}, "compromised"))
        for estimator, name, fn, fp in _COMPROMISED
    ),
    *(
        (f"ERCC {name}", _of_all("picture", {f"{name} IoB": f"{key}_iob", f"{name} IoE": f"{key}_ioe"}, ""))
        for name, key in (("FN", "fn"), ("FP", "fp"), ("TP", "tp"))
    ),
)

_DONE = {
    "lying agents": "lying_agents",
    "of these suspended": "lying_suspended",
    "delay s": "delay_s",
    "honest suspended": "honest_suspended",
    "false alarms": "false_alarms",
    "false withheld": "withheld_false",
    "true withheld": "withheld_true",
}
#: What the command centre's defence did in a run.
DEFENCE: Groups = (("defence", _of_all("defence", _DONE)),)

_DECEIVED = {
    "GOSPA between two m": "difference_gospa_m",
    "deceived at a time": "deceived.share",
    "deceived at most": "deceived.most",
}
_LOAD = {"busy": "busy_ratio", "frames a station sent in": "sent", "messages arrived": "arrived"}
#: How far the pictures of agents differ and are deceived, and the load of the radio channel.
COOPERATION: Groups = (
    ("pictures of the agents", _of_all("pictures", _DECEIVED)),
    ("radio channel", _of_all("channel", _LOAD)),
)

#: The estimator of what adversaries achieved.
ACHIEVED = "achieved"
#: The estimator of what happened to a driven car.
DRIVEN = "driven"


def attacks_differ(rows: Iterable[Row], baseline: str) -> bool:
    """Whether all configurations but the baseline have adversaries, so that differences are what attacks add."""
    has_attack = {
        row.configuration: any(each.estimator == ACHIEVED for each in row.numbers) for row in rows if row.numbers
    }
    return not has_attack.pop(baseline, False) and bool(has_attack) and all(has_attack.values())


def series_of(groups: Groups) -> list[StudySeries]:
    """The measures of all columns of the groups, one after the other."""
    return [series for _, columns in groups for series in columns.values()]


def unchanged(rows: Iterable[Row], columns: Mapping[str, StudySeries]) -> bool:
    """Whether all increments that are known are 0 in every trial."""
    known = [each for row in rows for series in columns.values() if (each := row.get(series)).known]
    return bool(known) and all(each.unchanged for each in known)


def present(rows: Sequence[Row], groups: Groups) -> Groups:
    """The groups in which any row has a number."""
    return tuple(
        group
        for group in groups
        if any(not math.isnan(row.get(series).mean) for row in rows for series in series_of((group,)))
    )
