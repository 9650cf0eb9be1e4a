"""Consequences of the estimates for driving: table rows."""

from __future__ import annotations

from typing import Any, NamedTuple

from mast_zenoh.report.runfolder import RunFolder
from mast_zenoh.report.tables.scores import DASH

#: Estimates by which a vehicle might drive, and their names.
ESTIMATES = {"truth": "truth", "local": "ego alone", "mission": "ego with picture"}

_WRONG_BRAKING = {"needless_brake_share": "brakes needlessly", "missed_brake_share": "fails to brake when it must"}
#: Shares below this count as none.
_MIN_SHARE = 0.0005


class DrivingRow(NamedTuple):
    """Driving metrics of an estimate; in parentheses, the change from a reference.

    run: label of the run
    objects, false, missed: all, false and missed objects in the vehicle's corridor, per frame
    overlapping: objects per frame that overlap the vehicle itself
    ttc_s: minimum time to collision, s
    brake: share of the frames with braking;  needless, omitted: share with needless and with omitted braking, with the
           part due to attacks, and the unattributed increase over the reference
    """

    estimate: str
    run: str
    objects: str
    false: str
    missed: str
    overlapping: str
    ttc_s: str
    brake: str
    needless: str
    omitted: str


def driving_rows(run: RunFolder, reference: RunFolder | None = None, name: str = "") -> list[DrivingRow]:
    """Rows for the truth, the ego alone and the ego with the picture.

    Empty if the ego is not a vehicle.
    reference: the run that this one is compared with, labelled `name`; it gets a row per estimate as well
    """
    own, references = _summaries(run), _summaries(reference)
    result = []
    for estimate, label in ESTIMATES.items():
        if estimate in own and estimate in references:
            result.append(_row(label, name, references[estimate], {}, name))
        if estimate in own:
            result.append(_row(label, run.label, own[estimate], references.get(estimate, {}), name))
    return result


def driving_differs(run: RunFolder, reference: RunFolder) -> bool:
    """Whether the ego's driving metrics differ between two runs, for an estimate that both have."""
    own, references = _summaries(run), _summaries(reference)
    return any(own[estimate] != references[estimate] for estimate in own.keys() & references.keys())


def _summaries(run: RunFolder | None) -> dict[str, dict[str, Any]]:
    """The ego's driving metrics by estimate."""
    if run is None:
        return {}
    summaries: dict[str, dict[str, Any]] = run.metrics.get("driving", {}).get(run.ego or "", {})
    return summaries


def _unattributed(summary: dict[str, Any], reference_summary: dict[str, Any], key: str) -> float:
    """Unattributed increase in a share of frames over the reference run; 0: none."""
    share, reference_share = summary.get(key), reference_summary.get(key)
    if share is None or reference_share is None:
        return 0.0
    attack = (summary.get(f"{key}_attack") or 0.0) - (reference_summary.get(f"{key}_attack") or 0.0)
    increase = float(share - reference_share - max(attack, 0.0))
    return increase if increase >= _MIN_SHARE else 0.0


def _row(
    estimate: str, run: str, summary: dict[str, Any], reference_summary: dict[str, Any], reference: str
) -> DrivingRow:
    def text(key: str, digits: int, scale: float = 1.0, missing: str = DASH) -> str:
        value, before = summary.get(key), reference_summary.get(key)
        unit = "%" if scale != 1.0 else ""
        if value is None:
            return missing
        number = f"{scale * value:.{digits}f}{unit}"
        if before is None:
            return number
        change = round(scale * (value - before), digits) + 0.0  # not a negative zero
        return f"{number} ({change:+.{digits}f})".replace("-", "\u2212")

    def share(key: str) -> str:
        attack, increase = summary.get(f"{key}_attack"), _unattributed(summary, reference_summary, key)
        notes = [f"{attack:.1%} by attack"] if attack else []
        notes += [f"{increase:.1%} more than {reference}, not attributed"] if increase else []
        return text(key, 1, 100.0) + (f" ({'; '.join(notes)})" if notes else "")

    return DrivingRow(
        estimate,
        run,
        text("corridor_objects", 2),
        text("corridor_false", 2),
        text("corridor_missed", 2),
        text("overlapping_objects", 2),
        text("min_ttc_s", 1, missing="never"),
        text("brake_share", 1, 100.0),
        share("needless_brake_share"),
        share("missed_brake_share"),
    )


def braking_by_attack(run: RunFolder) -> str:
    """How attacks made the ego with picture brake wrongly, in words; or empty."""
    mission = _summaries(run).get("mission", {})
    return _braking({words: mission.get(f"{key}_attack") for key, words in _WRONG_BRAKING.items()})


def unattributed_braking(run: RunFolder, reference: RunFolder, name: str) -> str:
    """Unattributed increase in wrong braking over another run, in words; or empty."""
    own, other = (_summaries(each).get("mission", {}) for each in (run, reference))
    braking = _braking({words: _unattributed(own, other, key) for key, words in _WRONG_BRAKING.items()})
    return f"{braking} more than {name}, not attributed" if braking else ""


def _braking(shares: dict[str, float | None]) -> str:
    parts = [f"{words} in {share:.1%} of the scored frames" for words, share in shares.items() if share]
    return f"the ego with the picture {' and '.join(parts)}" if parts else ""
