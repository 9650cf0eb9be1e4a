"""The tables of a run's page: achievements, confidence, driving, trust, causes, checks, latency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mast_zenoh.metrics.estimates import ESTIMATES, LOCAL, MISSION, PICTURE, TRUTH, subject_of
from mast_zenoh.metrics.measures import metric_named
from mast_zenoh.run_folder.finding import Finding, whole_percent
from mast_zenoh.runs.events import doubts, suspensions
from mast_zenoh.runs.interposers import hostile
from mast_zenoh.runs.run import Run
from mast_zenoh.show.findings.causes import reaches
from mast_zenoh.show.number_text import DASH, number
from mast_zenoh.show.tables.scores import score_of
from mast_zenoh.show.tables.text_table import TextTable
from mast_zenoh.tracking.base import OVERCONFIDENT

ALL = "all"
_ACHIEVED = (
    *("adversary", "number", "accepted", "for (s)", "number", "missed", "number", "off by (m)"),
    *("first\nsuccess (s)", "identity\nswitches"),
)
_ACHIEVED_GROUPS = ("", *("inserted objects",) * 3, *("hidden objects",) * 2, *("moved objects",) * 2, "", "")


def achieved_table(run: Run, limits: Sequence[Finding] = ()) -> TextTable:
    """A line per interposer other than links, and a total if there are several; no lines if nothing was measured.

    limits: reasons for limited effects, of interposers that have a line even if nothing was measured
    """
    achieved: Mapping[str, Mapping[str, Any]] = run.files.summary.get("achieved", {})
    names = [each.name for each in hostile(run)]
    centre = [name for name in names if reaches(run, name, PICTURE)]
    limited = {name for each in limits for name in each.who}
    names = [name for name in names if name in achieved or name in limited]
    lines = [_achieved(name, achieved.get(name, {}), in_picture=name in centre) for name in names]
    if len(lines) > 1 and ALL in achieved:
        lines.append(_achieved("all together", achieved[ALL], in_picture=bool(centre)))
    lines = [] if all(line[1] == DASH for line in lines) else lines
    return TextTable("", "", _ACHIEVED, lines, groups=_ACHIEVED_GROUPS)


def _achieved(name: str, each: Mapping[str, Any], *, in_picture: bool) -> tuple[str, ...]:
    """in_picture: whether it can affect the command centre's picture."""

    def number(key: str) -> str:
        return str(each.get(key, DASH))

    def both(key: str, form: str) -> str:
        values = [each.get(f"{key}_centre") if in_picture else None, each.get(f"{key}_ego")]
        return " / ".join(DASH if value is None else form.format(value) for value in values)

    inserted = number("inserted"), both("inserted_share", "{:.0%}"), both("inserted_s", "{:.1f}")
    hidden = number("hidden"), both("hidden_share", "{:.0%}")
    moved = number("moved"), both("moved_error_m", "{:.2f}")
    return name, *inserted, *hidden, *moved, both("first_success_s", "{:.1f}"), both("id_switches", "{}")


MESSAGES_TITLE = "Your metrics of messages"


def message_table(run: Run) -> TextTable:
    """A line per wire and metric of a user's of its messages; no lines without such metrics."""
    described = run.files.summary.get("own_metrics", {})
    lines = []
    for wire, metrics in run.files.summary.get("messages", {}).items():
        for name, value in metrics.items():
            metric = metric_named(name, described)
            score = score_of(value, metric)
            deviation = DASH if score.std is None else f"{score.std:.{metric.digits}f}"
            lines.append((wire, metric.heading, score.number, deviation))
    return TextTable(MESSAGES_TITLE, "", ("wire", "metric", "mean", "standard\ndeviation"), lines, 2)


def own_messages(run: Run) -> TextTable:
    """The same for the terminal, without the wires of agents but the ego."""
    table, others = message_table(run), {*run.agents} - {run.ego}
    lines = [line for line in table.lines if others.isdisjoint(line[0].split("/"))]
    left_out = f"; {len(table.lines) - len(lines)} of other agents are in the report"
    return table._replace(title=table.title + left_out * (len(lines) < len(table.lines)), lines=lines)


_NEES_QUANTITIES = {"position": "positions", "velocity": "velocities"}
NEES_TITLE = "NEES: errors relative to covariances, 2 expected; * above its 95 % bounds"
_NEES = ("NEES\n(bounds)", "times more\nconfident", "typically")
_ESTIMATES = ("estimate", *_NEES, *_NEES, "pairs", "verdict")
_ESTIMATE_GROUPS = ("", *("position",) * 3, *("velocity",) * 3, "", "")
#: The verdict where the mean of the errors alone, not their median, is beyond what covariances say.
_ABOVE = "NEES above its bounds"
_TRACKERS = ("tracker of", "NIS\n(bounds)", "times more\nconfident", "pairs", "sudden", "verdict")
_VERDICT = {"verdict": "text"}
_NEES_OF = (PICTURE, MISSION)


def nees_table(runs: Mapping[str, Mapping[str, Any]], agent: str) -> TextTable:
    """The NEES of positions and velocities in an agent's picture and mission estimate, a line per run.

    runs: metrics by label; no lines where none has any. Lines with a value above its bounds are bad.
    """
    lines, bad = [], []
    for label, metrics in runs.items():
        of_agent = metrics.get("consistency", {}).get(agent, {})
        summaries = [of_agent.get(estimate, {}).get(name, {}) for estimate in _NEES_OF for name in _NEES_QUANTITIES]
        if any(each.get("nees") is not None for each in summaries):
            lines.append([label, *map(_nees_cell, summaries)])
            bad.append(any(map(_exceeds, summaries)))
    headings = ["run", *_NEES_QUANTITIES.values(), *_NEES_QUANTITIES.values()]
    groups = ["", *(ESTIMATES[estimate].column for estimate in _NEES_OF for _ in _NEES_QUANTITIES)]
    return TextTable(NEES_TITLE, "", headings, lines, groups=groups, bad=bad)


def _nees_cell(summary: Mapping[str, Any]) -> str:
    nees = summary.get("nees")
    return DASH if nees is None else f"{_number(nees)}{'*' * _exceeds(summary)}"


#: More estimates than these are split into those of the ego and the others.
_MOST_ESTIMATES = 12


def confidence_tables(run: Run) -> tuple[TextTable, TextTable, TextTable]:
    """How confident estimates, and the trackers of nodes, are compared with their accuracy.

    The third: estimates besides the ego's that have no notable verdict, if there are many.
    """
    lines, trackers, others = [], [], []
    own_pictures = "pictures" in run.files.summary
    for agent, estimates in run.files.summary.get("consistency", {}).items():
        for estimate, summaries in estimates.items():
            numbers = [each for name in ("position", "velocity") for each in _numbers(summaries[name])]
            verdicts = {name: each["verdict"] or _ABOVE * _exceeds(each) for name, each in summaries.items()}
            verdict = "; ".join(f"{name}: {each}" for name, each in verdicts.items() if each)
            pairs = str(summaries["position"]["pairs"])
            line = (subject_of(agent, estimate, own_pictures), *numbers, pairs, verdict)
            lines.append(line)
            others += [line] * (agent != run.ego and OVERCONFIDENT not in verdict)
    for name, each in run.files.record.get("innovations", {}).items():
        numbers = [_with_range(each, "nis", "low", "high"), _with_range(each, "factor", "factor_low", "factor_high")]
        trackers.append((name, *numbers, str(each["pairs"]), str(each["sudden"]), each["verdict"] or ""))
    others = others if len(lines) > _MOST_ESTIMATES else []
    return (
        _of_confidence(_ESTIMATES, [line for line in lines if line not in others], _ESTIMATE_GROUPS),
        _of_confidence(_TRACKERS, trackers),
        _of_confidence(_ESTIMATES, others, _ESTIMATE_GROUPS),
    )


def _of_confidence(headings: Sequence[str], lines: Sequence[Sequence[str]], groups: Sequence[str] = ()) -> TextTable:
    """A table whose last column is a verdict."""
    bad = [OVERCONFIDENT in line[-1] for line in lines]
    return TextTable("", "", headings, lines, groups=groups, kinds=_VERDICT, bad=bad)


def _exceeds(summary: Mapping[str, Any]) -> bool:
    """Whether the mean NEES of a summary is above its 95 % bounds, whatever its median is."""
    return summary.get("nees") is not None and summary.get("high") is not None and summary["nees"] > summary["high"]


_PICTURES = (
    *("agent", "missed", "false", "RMSE (m)", "deceived (% of the frames\nfrom the first lie on)", "NEES of positions"),
)
_PICTURE_GROUPS = ("", *("objects per frame",) * 2, "", "", "")


def picture_table(run: Run) -> TextTable:
    """A line for each agent's picture; none where all agents get the same one."""
    summary, lines, bad = run.files.summary, [], []
    for agent, share in summary.get("pictures", {}).get("deceived", {}).get("agents", {}).items():
        scores = summary["agents"][agent][PICTURE]
        position = summary["consistency"].get(agent, {}).get(PICTURE, {}).get("position", {})
        cells = [number(each) for each in (scores["fn"]["mean"], scores["fp"]["mean"], scores["rmse_m"])]
        bad.append(_exceeds(position))
        nees = number(position.get("nees")) + (f" (bound {number(position['high'])})" if bad[-1] else "")
        lines.append((agent, *cells, whole_percent(share), nees))
    return TextTable("", "", _PICTURES, lines, groups=_PICTURE_GROUPS, bad=bad)


def _numbers(summary: Mapping[str, Any]) -> tuple[str, str, str]:
    return (
        _with_range(summary, "nees", "low", "high"),
        _with_range(summary, "factor", "factor_low", "factor_high"),
        _with_range(summary, "typical_factor", "typical_low", "typical_high"),
    )


def _with_range(summary: Mapping[str, Any], name: str, low: str, high: str) -> str:
    if summary[name] is None:
        return DASH
    ends = f"({_number(summary[low])} to {_number(summary[high])})".replace(" ", "\u00a0")  # never broken
    return f"{_number(summary[name])} {ends}"


def _number(value: float | None) -> str:
    if value is None:
        return "?"
    return f"{value:.2f}" if value < 100.0 else f"{value:.3g}"


#: Estimates by which a vehicle might drive, and their names.
DRIVEN_BY = {TRUTH: TRUTH, **{name: ESTIMATES[name].column for name in (LOCAL, MISSION)}}

#: Shares below this count as none.
_MIN_SHARE = 0.0005


#: s, least times to collision beyond this say nothing more.
_LONG_S = 60.0

_DRIVING = (
    *("objects\u00a0in\ncorridor", "false", "missed", "overlapping\nthe ego"),
    *("least time\nto\u00a0collision\u00a0(s)", "brakes", "needlessly", "omits to"),
)


def driving_table(run: Run, reference: Run | None = None, name: str = "") -> TextTable:
    """Lines for the truth, the ego alone and the ego with the picture; in parentheses, the change from a reference.

    None if the ego is not a vehicle. Wrong braking has the part due to attacks, and the unattributed increase over the
    reference.
    reference: the run that this one is compared with, labelled `name`; it gets a line per estimate as well
    """
    own, references = _summaries(run), _summaries(reference)
    lines = []
    for estimate, label in DRIVEN_BY.items():
        if estimate in own and estimate in references:
            lines.append(_driving((label, name), references[estimate], {}, name))
        if estimate in own:
            labels = (label, run.name) if reference is not None else (label,)
            lines.append(_driving(labels, own[estimate], references.get(estimate, {}), name))
    names = ("by",) if reference is None else ("by", "run")
    return TextTable("", "", names + _DRIVING, lines, len(names))


_DRIVEN = (
    *("colli-\nsions", "near\nmisses", "all", "needless", "missed", "hardest\n(m/s²)"),
    *("least time\nto\u00a0collision\u00a0(s)", "below safe\ndistance (s)"),
    *("way\n(m)", "standing\n(s)", "hard brakes\nbehind"),
)
_DRIVEN_GROUPS = ("", "", *("brakes",) * 4, *("",) * 5)


def driven_table(run: Run, reference: Run | None = None, name: str = "") -> TextTable:
    """What happened to driven cars: a line per car, and one for the reference, labelled `name`; no lines without."""
    others = reference.files.summary.get("driven", {}) if reference is not None else {}
    lines = []
    for car, happened in run.files.summary.get("driven", {}).items():
        if car in others:
            lines.append(_driven((car, name), others[car]))
        lines.append(_driven((car, run.name) if reference is not None else (car,), happened))
    names = ("car",) if reference is None else ("car", "run")
    return TextTable("", "", names + _DRIVEN, lines, len(names), groups=("",) * len(names) + _DRIVEN_GROUPS)


def _driven(labels: Sequence[str], happened: Mapping[str, Any]) -> tuple[str, ...]:
    ttc = happened["min_ttc_s"]
    far = "never" if ttc is None else f"more than {_LONG_S:.0f}" if ttc > _LONG_S else f"{ttc:.1f}"
    counts = len(happened["collisions"]), happened["near_misses"], len(happened["brakes"])
    brakes = happened["needless_brakes"], happened["missed_brakes"]
    measures = (happened[key] for key in ("rss_unsafe_s", "progress_m", "standing_s"))
    unsafe, way, standing = (f"{value:.1f}" for value in measures)
    hardest = f"{happened['hardest_braking_mps2']:.1f}"
    behind = str(happened["behind"]["hard_brakes"])
    return *labels, *map(str, (*counts, *brakes)), hardest, far, unsafe, way, standing, behind


def _summaries(run: Run | None) -> dict[str, dict[str, Any]]:
    """The ego's driving metrics by estimate."""
    if run is None:
        return {}
    summaries: dict[str, dict[str, Any]] = run.files.summary.get("driving", {}).get(run.ego or "", {})
    return summaries


def _unattributed(summary: dict[str, Any], reference_summary: dict[str, Any], key: str) -> float:
    """Unattributed increase in a share of frames over the reference run; 0: none."""
    share, reference_share = summary.get(key), reference_summary.get(key)
    if share is None or reference_share is None:
        return 0.0
    attack = (summary.get(f"{key}_attack") or 0.0) - (reference_summary.get(f"{key}_attack") or 0.0)
    increase = float(share - reference_share - max(attack, 0.0))
    return increase if increase >= _MIN_SHARE else 0.0


def _driving(
    labels: Sequence[str], summary: dict[str, Any], reference_summary: dict[str, Any], reference: str
) -> tuple[str, ...]:
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

    counts = (text(key, 2) for key in ("corridor_objects", "corridor_false", "corridor_missed", "overlapping_objects"))
    far = (summary.get("min_ttc_s") or 0.0) > _LONG_S
    ttc = f"more than {_LONG_S:.0f}" if far else text("min_ttc_s", 1, missing="never")
    brake = text("brake_share", 1, 100.0)
    return *labels, *counts, ttc, brake, share("needless_brake_share"), share("missed_brake_share")


_SUSPENSIONS = ("suspended agent", "from (s)", "to (s)", "it was", "after its\nfirst lie (s)", "reason")
_DOUBTS = ("undecided agent", "from (s)", "to (s)", "it was", "reason")
_JUDGED = {"it was": "text", "reason": "words"}


def suspension_table(run: Run) -> TextTable:
    """All suspensions, with the reason that the command centre gave for each; false alarms are bad."""
    agents = run.files.summary.get("integrity", {}).get("agents", {})
    lines, bad, detected = [], [], set()
    for each in suspensions(run):
        agent = each["agent"]
        delay_s = agents[agent].get("suspended_after_s")
        first = delay_s is not None and agent not in detected and each["from_s"] >= agents[agent]["first_lie_s"]
        detected |= {agent} if first else set()
        lines.append((*_period(run, each), f"{delay_s:.1f}" if first else DASH, each["reason"] or DASH))
        bad.append(each["conduct"] == "honest")
    return TextTable("", "", _SUSPENSIONS, lines, kinds=_JUDGED, bad=bad)


def _period(run: Run, each: Mapping[str, Any]) -> tuple[str, ...]:
    """An agent, the beginning and end of its suspension or of a doubt, and what it was."""
    until = "end" if each["until_s"] is None else f"{each['until_s']:.1f}"
    return each["agent"], f"{each['from_s']:.1f}", until, _conduct(run, each)


def _conduct(run: Run, period: Mapping[str, Any]) -> str:
    """What an agent was when a period began, and when it lied, if it was honest then and is a liar at other times."""
    first_s = run.files.summary["integrity"]["agents"][period["agent"]].get("first_lie_s")
    if period["conduct"] == "lying" or first_s is None:
        return str(period["conduct"])
    return f"{period['conduct']}, " + (f"lies from {first_s:.1f} s on" if first_s > period["from_s"] else "lied before")


def undecided_table(run: Run) -> TextTable:
    """All periods in which the command centre could not decide whether an agent lies, with its reason for each."""
    lines = [(*_period(run, each), each["reason"] or DASH) for each in doubts(run)]
    return TextTable("", "", _DOUBTS, lines, kinds=_JUDGED)


def conduct_table(run: Run) -> TextTable:
    """The seconds of all agents by conduct and state."""
    seconds = run.files.summary.get("integrity", {}).get("seconds", {})
    states = list(next(iter(seconds.values()), {}))
    lines = [
        (conduct, *(f"{of_state[state]:.1f}" for state in states))
        for conduct, of_state in seconds.items()
        if any(of_state.values())
    ]
    return TextTable("", "", ("seconds of all agents", *states), lines)


#: Groups of causes, as in `fn_split` and `fp_split` of metrics.json.
CAUSE_GROUPS = ("fault", "attack", "natural")
_WITH_DEFENCE = ("fault", "attack", "withheld", "natural")
_MAIN_WIRES = ("tracks", "collated", "picture")
_SPLITS = (("fn_split", "missed"), ("fp_split", "false"))


def cause_groups(*summaries: Mapping[str, Any]) -> tuple[str, ...]:
    """The groups of causes in the tables of some runs: with "withheld" if objects were withheld in any."""
    pictures = [each.get("picture", {}) for metrics in summaries for each in metrics.get("agents", {}).values()]
    withheld = any((picture.get(name) or {}).get("withheld") for picture in pictures for name, _ in _SPLITS)
    return _WITH_DEFENCE if withheld else CAUSE_GROUPS


def cause_table(runs: Mapping[str, Mapping[str, Any]], agent: str | None = None) -> TextTable:
    """Missed and false objects per frame in the picture of each agent by group of causes, of those with known causes.

    runs: metrics by label; agent: only of this one, a line per run
    """
    groups = cause_groups(*runs.values())
    lines = []
    for label, metrics in runs.items():
        for name, estimators in metrics.get("agents", {}).items():
            splits = [estimators.get("picture", {}).get(key) for key, _ in _SPLITS]
            if all(splits) and agent in (None, name):
                numbers = [number(each.get(group)) for each in splits for group in groups]
                lines.append((label if agent else name, *numbers))
    errors = ("", *(error for _, error in _SPLITS for _ in groups))
    title = "Causes of missed and false objects, per frame in the picture"
    return TextTable(title, "", ("run" if agent else "picture of", *groups, *groups), lines, groups=errors)


_CHECKS = ("check", "outcome", "found")
_CHECK_KINDS = {"outcome": "text", "found": "words"}


def check_table(checks: Mapping[str, Any]) -> TextTable:
    """A line per check, failed ones first; their outcome is `ok`, `failed` or `not checked`."""
    lines = []
    for each in checks.get("checks", ()):
        skipped = not each.get("values", {}).get("checked", True)
        outcome = "failed" if not each["ok"] else "not checked" if skipped else "ok"
        lines.append((str(each["name"]), outcome, each.get("detail", "").removeprefix("not checked: ")))
    lines.sort(key=lambda line: ("failed", "ok", "not checked").index(line[1]))
    return TextTable("", "", _CHECKS, lines, kinds=_CHECK_KINDS, bad=[line[1] == "failed" for line in lines])


_PERCENTILES = ("p50", "p95", "p99")


def latency_tables(metrics: Mapping[str, Any]) -> tuple[TextTable, TextTable, TextTable]:
    """Latency from the simulator's frame to its message, of the wires between agents and picture and of the others.

    The third: late messages by agent.
    """
    headings = ("wire", *(f"{p[1:]} % (ms)" for p in _PERCENTILES), "frames")
    wires = metrics.get("latency_ms", {}).get("by_wire") or {}
    main, others = list[Sequence[str]](), list[Sequence[str]]()
    for wire, summary in wires.items():
        if summary.get("p50") is not None:
            line = (wire, *(number(summary.get(p)) for p in _PERCENTILES), str(summary.get("n", DASH)))
            (main if wire.rpartition("/")[2] in _MAIN_WIRES else others).append(line)
    late = [(str(agent), str(int(count))) for agent, count in (metrics.get("late") or {}).items()]
    by_wire, others_by_wire = (TextTable("", "", headings, each, kinds={"wire": "code"}) for each in (main, others))
    return by_wire, others_by_wire, TextTable("", "", ("agent", "late messages"), late)


def check_lines(checks: Mapping[str, Any]) -> list[str]:
    """Terminal lines of the checks, failed ones first."""
    lines = check_table(checks).lines
    return [f"check {name}: {outcome}{f' ({detail})' if detail else ''}" for name, outcome, detail in lines]
