"""The tables of a run's page: achievements, confidence, driving, trust, causes, checks, latency."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.table import Table

from mast_zenoh.metrics.estimates import subject_of
from mast_zenoh.report.narrative.adversaries import explanations
from mast_zenoh.report.narrative.attribution import reaches
from mast_zenoh.report.tables.text_table import DASH
from mast_zenoh.viewer.events import suspensions
from mast_zenoh.viewer.interposers import interposers
from mast_zenoh.viewer.run import RunRecord

ALL = "all"


class AchievedRow(NamedTuple):
    """What one adversary achieved, as text.

    Pairs are for the picture ("centre") and for the ego with the picture, in this order.

    inserted, hidden, moved: number of objects manipulated in this way
    accepted: share of the inserted objects followed by a track;  believed_s: s, mean duration of that
    missed:   share of the hidden objects that were missed
    error_m:  m, mean error of the moved objects' tracks
    first_s:  s, from its first change to its first success
    switches: identity switches due to it
    why:      reasons for limited effects; may be empty
    """

    adversary: str
    inserted: str
    accepted: tuple[str, str]
    believed_s: tuple[str, str]
    hidden: str
    missed: tuple[str, str]
    moved: str
    error_m: tuple[str, str]
    first_s: tuple[str, str]
    switches: tuple[str, str]
    why: tuple[str, ...]


def achieved_rows(run: RunRecord, reference: RunRecord | None = None) -> list[AchievedRow]:
    """A row per interposer other than links, and a total if there are several.

    reference: the run that this one is compared with, see `explanations`
    """
    achieved: Mapping[str, Mapping[str, Any]] = run.metrics.get("achieved", {})
    why = explanations(run, reference)
    names = [each.name for each in interposers(run) if not each.is_link]
    centre = [name for name in names if reaches(run, name, "picture")]
    rows = [
        _row(name, achieved.get(name, {}), why.get(name, ()), in_picture=name in centre)
        for name in names
        if name in achieved or name in why
    ]
    if len(rows) > 1 and ALL in achieved:
        rows.append(_row("all together", achieved[ALL], (), in_picture=bool(centre)))
    return rows


def _row(name: str, each: Mapping[str, Any], why: tuple[str, ...], *, in_picture: bool) -> AchievedRow:
    """in_picture: whether it can affect the command centre's picture."""

    def both(key: str, form: str) -> tuple[str, str]:
        values = [each.get(f"{key}_centre") if in_picture else None, each.get(f"{key}_ego")]
        centre, ego = (DASH if value is None else form.format(value) for value in values)
        return centre, ego

    return AchievedRow(
        adversary=name,
        inserted=str(each.get("inserted", DASH)),
        accepted=both("inserted_share", "{:.0%}"),
        believed_s=both("inserted_s", "{:.1f}"),
        hidden=str(each.get("hidden", DASH)),
        missed=both("hidden_share", "{:.0%}"),
        moved=str(each.get("moved", DASH)),
        error_m=both("moved_error_m", "{:.2f}"),
        first_s=both("first_success_s", "{:.1f}"),
        switches=both("id_switches", "{}"),
        why=why,
    )


class EstimateRow(NamedTuple):
    """One estimate; the verdict of either quantity is in words, empty: none.

    nees, factor, typical: of position;  v_nees, v_factor, v_typical: of velocity; with their 95 % intervals
    """

    estimate: str
    nees: str
    factor: str
    typical: str
    v_nees: str
    v_factor: str
    v_typical: str
    pairs: int
    verdict: str


class TrackerRow(NamedTuple):
    """The tracker of one node; nis with its bounds."""

    node: str
    nis: str
    factor: str
    pairs: int
    sudden: int
    verdict: str


def estimate_rows(run: RunRecord) -> list[EstimateRow]:
    """A row for each estimate of each agent; empty for a run of an earlier version."""
    rows = []
    for agent, estimates in run.metrics.get("consistency", {}).items():
        for estimate, summaries in estimates.items():
            position, velocity = summaries["position"], summaries["velocity"]
            verdicts = [f"{name}: {each['verdict']}" for name, each in summaries.items() if each["verdict"]]
            rows.append(
                EstimateRow(
                    subject_of(agent, estimate),
                    *_numbers(position),
                    *_numbers(velocity),
                    position["pairs"],
                    "; ".join(verdicts),
                )
            )
    return rows


def tracker_rows(run: RunRecord) -> list[TrackerRow]:
    """A row for each node with a tracker that tells; empty for a run of an earlier version."""
    return [
        TrackerRow(
            name,
            _with_range(each, "nis", "low", "high"),
            _with_range(each, "factor", "factor_low", "factor_high"),
            each["pairs"],
            each["sudden"],
            each["verdict"] or "",
        )
        for name, each in run.run.get("innovations", {}).items()
    ]


def _numbers(summary: Mapping[str, Any]) -> tuple[str, str, str]:
    return (
        _with_range(summary, "nees", "low", "high"),
        _with_range(summary, "factor", "factor_low", "factor_high"),
        _with_range(summary, "typical_factor", "typical_low", "typical_high"),
    )


def _with_range(summary: Mapping[str, Any], name: str, low: str, high: str) -> str:
    if summary[name] is None:
        return DASH
    return f"{_number(summary[name])} ({_number(summary[low])} to {_number(summary[high])})"


def _number(value: float | None) -> str:
    if value is None:
        return "?"
    return f"{value:.2f}" if value < 100.0 else f"{value:.3g}"


#: Estimates by which a vehicle might drive, and their names.
DRIVEN_BY = {"truth": "truth", "local": "ego alone", "mission": "ego with picture"}

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


def driving_rows(run: RunRecord, reference: RunRecord | None = None, name: str = "") -> list[DrivingRow]:
    """Rows for the truth, the ego alone and the ego with the picture.

    Empty if the ego is not a vehicle.
    reference: the run that this one is compared with, labelled `name`; it gets a row per estimate as well
    """
    own, references = _summaries(run), _summaries(reference)
    result = []
    for estimate, label in DRIVEN_BY.items():
        if estimate in own and estimate in references:
            result.append(_driving_row(label, name, references[estimate], {}, name))
        if estimate in own:
            result.append(_driving_row(label, run.label, own[estimate], references.get(estimate, {}), name))
    return result


def driving_differs(run: RunRecord, reference: RunRecord) -> bool:
    """Whether the ego's driving metrics differ between two runs, for an estimate that both have."""
    own, references = _summaries(run), _summaries(reference)
    return any(own[estimate] != references[estimate] for estimate in own.keys() & references.keys())


def _summaries(run: RunRecord | None) -> dict[str, dict[str, Any]]:
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


def _driving_row(
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


def braking_by_attack(run: RunRecord) -> str:
    """How attacks made the ego with picture brake wrongly, in words; or empty."""
    mission = _summaries(run).get("mission", {})
    return _braking({words: mission.get(f"{key}_attack") for key, words in _WRONG_BRAKING.items()})


def unattributed_braking(run: RunRecord, reference: RunRecord, name: str) -> str:
    """Unattributed increase in wrong braking over another run, in words; or empty."""
    own, other = (_summaries(each).get("mission", {}) for each in (run, reference))
    braking = _braking({words: _unattributed(own, other, key) for key, words in _WRONG_BRAKING.items()})
    return f"{braking} more than {name}, not attributed" if braking else ""


def _braking(shares: dict[str, float | None]) -> str:
    parts = [f"{words} in {share:.1%} of the scored frames" for words, share in shares.items() if share]
    return f"the ego with the picture {' and '.join(parts)}" if parts else ""


_NONE = "\u2013"
#: Suspensions that the terminal shows.
_MOST_LINES = 8


class SuspensionRow(NamedTuple):
    """A suspension as the page shows it.

    false_alarm: whether the agent was honest
    """

    agent: str
    from_s: str
    until_s: str
    conduct: str
    after_s: str
    reason: str
    false_alarm: bool


def suspension_rows(run: RunRecord) -> list[SuspensionRow]:
    """All suspensions, with the reason that the command centre gave for each."""
    agents = run.metrics.get("integrity", {}).get("agents", {})
    result, detected = [], set()
    for each in suspensions(run):
        agent = each["agent"]
        delay_s = agents[agent].get("suspended_after_s")
        first = delay_s is not None and agent not in detected and each["from_s"] >= agents[agent]["first_lie_s"]
        detected |= {agent} if first else set()
        result.append(
            SuspensionRow(
                agent,
                f"{each['from_s']:.1f}",
                "end" if each["until_s"] is None else f"{each['until_s']:.1f}",
                each["conduct"],
                f"{delay_s:.1f}" if first else _NONE,
                each["reason"] or _NONE,
                each["conduct"] == "honest",
            )
        )
    return result


def conduct_rows(run: RunRecord) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """States, and for each conduct the seconds of all agents in each state; ([], []) without trust."""
    seconds = run.metrics.get("integrity", {}).get("seconds", {})
    states = list(next(iter(seconds.values()), {}))
    return states, [
        (conduct, [f"{of_state[state]:.1f}" for state in states])
        for conduct, of_state in seconds.items()
        if any(of_state.values())
    ]


def trust_sentences(run: RunRecord) -> list[str]:
    """The result in sentences: who was never suspended, false alarms, and withheld objects."""
    part: dict[str, Any] = run.metrics.get("integrity", {})
    if not part:
        return []
    missed = [
        f"{name} was never suspended in the {agent['observed_s']:.1f} s after its first lie"
        for name, agent in part["agents"].items()
        if agent["lied"] and agent["suspended_after_s"] is None
    ]
    honest = part["honest_suspended"]
    times = "once" if part["false_alarms"] == 1 else f"{part['false_alarms']} times"
    alarms = f"Honest agents were suspended {times}: {', '.join(honest)}" if honest else ""
    withheld = part.get("withheld", {})
    objects = (
        f"Withheld from the picture, per frame: {withheld['false']:.2f} false and {withheld['true']:.2f} true objects"
    )
    return [*missed, alarms or "No honest agent was suspended", *([objects] if withheld else [])]


def suspension_lines(run: RunRecord) -> list[str]:
    """Which agents the command centre suspended, when and why, a line each."""
    lines = [
        f"the command centre suspended {row.agent} ({row.conduct}) at {row.from_s} s"
        + (f", {row.after_s} s after its first lie" if row.after_s != _NONE else "")
        + (f": {row.reason}" if row.reason != _NONE else "")
        for row in suspension_rows(run)
    ]
    more = f"  and {len(lines) - _MOST_LINES} suspensions more, see the report"
    return [*lines[:_MOST_LINES], more] if len(lines) > _MOST_LINES else lines


#: Groups of causes, as in `fn_split` and `fp_split` of metrics.json.
CAUSE_GROUPS = ("fault", "attack", "natural")
_WITH_DEFENCE = ("fault", "attack", "withheld", "natural")
_PERCENTILES = ("p50", "p95", "p99")
_MAIN_WIRES = ("tracks", "collated", "picture")
_SPLITS = (("fn_split", "missed"), ("fp_split", "false"))


class CauseRow(NamedTuple):
    """Missed and false objects per frame of one agent's picture, by group of causes."""

    agent: str
    missed: tuple[str, ...]
    false: tuple[str, ...]


class CheckRow(NamedTuple):
    """A check; `outcome` is "ok", "failed" or "not checked"."""

    name: str
    outcome: str
    detail: str


class LatencyRow(NamedTuple):
    """Latency of a wire in ms, from the simulator's frame to the frame's message.

    n: frames
    main: whether the wire is between the agents and the picture
    """

    wire: str
    p50: str
    p95: str
    p99: str
    n: str
    main: bool


def cause_groups(*summaries: Mapping[str, Any]) -> tuple[str, ...]:
    """The groups of causes in the tables of some runs: with "withheld" if objects were withheld in any."""
    pictures = [each.get("picture", {}) for metrics in summaries for each in metrics.get("agents", {}).values()]
    withheld = any((picture.get(name) or {}).get("withheld") for picture in pictures for name, _ in _SPLITS)
    return _WITH_DEFENCE if withheld else CAUSE_GROUPS


def cause_rows(metrics: Mapping[str, Any], groups: tuple[str, ...] = CAUSE_GROUPS) -> list[CauseRow]:
    """A row per agent whose picture has causes of errors; groups: of its causes."""
    rows = []
    for agent, estimators in metrics.get("agents", {}).items():
        splits = [estimators.get("picture", {}).get(name) for name, _ in _SPLITS]
        if all(splits):
            missed, false = (tuple(_two_decimals(each.get(group)) for group in groups) for each in splits if each)
            rows.append(CauseRow(agent, missed, false))
    return rows


def check_rows(checks: Mapping[str, Any]) -> list[CheckRow]:
    """The checks, failed ones first."""
    rows = []
    for each in checks.get("checks", ()):
        skipped = not each.get("values", {}).get("checked", True)
        outcome = "failed" if not each["ok"] else "not checked" if skipped else "ok"
        detail = each.get("detail", "").removeprefix("not checked: ")
        rows.append(CheckRow(str(each["name"]), outcome, detail))
    return sorted(rows, key=lambda row: ("failed", "ok", "not checked").index(row.outcome))


def latency_rows(metrics: Mapping[str, Any]) -> list[LatencyRow]:
    """A row per wire whose latency was measured, in the order of metrics.json."""
    wires = metrics.get("latency_ms", {}).get("by_wire") or {}
    rows = []
    for wire, summary in wires.items():
        p50, p95, p99 = (summary.get(p) for p in _PERCENTILES)
        if p50 is not None:
            main = wire.rpartition("/")[2] in _MAIN_WIRES
            rows.append(
                LatencyRow(
                    wire, _two_decimals(p50), _two_decimals(p95), _two_decimals(p99), str(summary.get("n", DASH)), main
                )
            )
    return rows


def late_rows(metrics: Mapping[str, Any]) -> list[tuple[str, int]]:
    """(agent, number of its messages after the broker's latency budget)."""
    return [(str(agent), int(number)) for agent, number in (metrics.get("late") or {}).items()]


def cause_table(metrics: Mapping[str, Mapping[str, Any]], agent: str) -> Table | None:
    """Terminal table of the causes of an agent's errors; None: not known.

    A row per run.

    metrics: by the run's label
    """
    groups = cause_groups(*metrics.values())
    rows = {label: row for label, each in metrics.items() for row in cause_rows(each, groups) if row.agent == agent}
    if not rows:
        return None
    title = "Causes of missed and false objects, per frame in the picture"
    table = Table(title=title, title_justify="left", title_style="dim", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", justify="left", no_wrap=True)
    for _, error in _SPLITS:
        for index, group in enumerate(groups):
            table.add_column(f"{error if index == 0 else ''}\n{group}", justify="right")
    for label, row in rows.items():
        table.add_row(label, *row.missed, *row.false)
    return table


def check_lines(checks: Mapping[str, Any]) -> list[str]:
    """Terminal lines of the checks, failed ones first."""
    return [f"check {row.name}: {row.outcome}{f' ({row.detail})' if row.detail else ''}" for row in check_rows(checks)]


def _two_decimals(value: float | None) -> str:
    return DASH if value is None else f"{value:.2f}"
