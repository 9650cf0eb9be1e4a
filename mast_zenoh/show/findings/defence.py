"""What a defence did, what the agents' own pictures are like, and the load of the radio channel: as measured."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any

from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.run_folder.finding import Finding
from mast_zenoh.runs.events import doubts, suspensions
from mast_zenoh.runs.run import Run
from mast_zenoh.show.findings.adversaries import altered_on_the_way


def of_defence(run: Run) -> list[Finding]:
    """Which agents the defence suspended and when, which it missed, doubted or corrected, and what it withheld.

    None if the run has no defence.
    """
    measured: Mapping[str, Any] = run.files.summary.get("integrity", {})
    if not measured or run.defence == "NoIntegrity":
        return []
    agents: Mapping[str, Mapping[str, Any]] = measured["agents"]
    altered, result, by_state = altered_on_the_way(run), list[Finding](), defaultdict[str, dict[str, float]](dict)
    for name, agent in agents.items():
        after_s, observed_s, doubt = agent["suspended_after_s"], agent["observed_s"], agent.get("undecided")
        conducts = {each["conduct"] for each in agent["suspensions"]} - ({"lying"} if after_s is not None else set())
        if after_s is not None:
            result.append(Finding("judged", (name,), "suspended", after_s, unit="s"))
        elif observed_s is not None:
            by_state["altered on the way" if name in altered else "never suspended"][name] = observed_s
        for conduct in sorted(conducts):
            before = agent["lied"] and observed_s is None
            by_state["suspended before lying" if before else f"suspended while {conduct}"][name] = 0.0
        if doubt:
            by_state["undecided to the end" if doubt[-1]["until_s"] is None else "undecided for a time"][name] = 0.0
        if wrongly_s := agent.get("seconds", {}).get("honest", {}).get("faulty", 0.0):
            by_state["corrected without a fault"][name] = wrongly_s
    if not any(agent["suspensions"] for agent in agents.values()):
        result.append(Finding("judged", what="suspended no agent"))
    for what, of in by_state.items():
        each = tuple(Finding("lasting", (name,), value=time_s or None, unit="s") for name, time_s in of.items())
        result.append(Finding("judged", tuple(of), what, max(of.values()) or None, unit="s", parts=each))
    return [*result, *_relays(measured), *_withheld(run, measured)]


def _withheld(run: Run, measured: Mapping[str, Any]) -> list[Finding]:
    """The false and true objects that the defence withheld; and the ego's missed ones for it, in its range."""
    if "withheld" not in measured:
        return []
    false, true = measured["withheld"]["false"], measured["withheld"]["true"]
    result, unit = [Finding("withheld", (run.defence,), "", false, true, "objects a frame")], "objects a frame"
    missed = (run.scores_of(PICTURE).get("fn_split") or {}).get("withheld")
    if missed is not None and f"{missed:.2f}" != f"{true:.2f}":  # also those that only suspended agents report
        result.append(Finding("withheld", (run.ego or "",), "missed", missed, None, unit))
    return result


def _relays(measured: Mapping[str, Any]) -> list[Finding]:
    """Which honest agents had what they relay suspended, and which of these relayed an attack's errors."""
    relays = measured.get("relays", {})
    honest = tuple(relays.get("honest_suspended", ()))
    periods = {agent: relays["agents"][agent]["suspensions"] for agent in honest}
    deceived = tuple(
        agent
        for agent, of_agent in periods.items()
        if any(each["deceived"] for each in of_agent if each["conduct"] == "honest")
    )
    return [Finding("relays", honest, value=relays["false_alarms"], cause=deceived)] if honest else []


def periods(run: Run) -> list[Finding]:
    """The first suspension and the first doubt of each agent with its reason, and how many follow."""
    result = []
    for what, of_all in (("suspended", suspensions(run)), ("undecided", doubts(run))):
        numbers = Counter(each["agent"] for each in of_all)
        for agent, number in numbers.items():
            first = next(each for each in of_all if each["agent"] == agent)
            until = run.files.summary["frames"] * run.period_s if first["until_s"] is None else first["until_s"]
            cause = (first["conduct"], *[first["reason"]] * bool(first["reason"]))
            result.append(Finding("period", (agent,), what, number, None, "", "", (first["from_s"], until), cause))
    return result


def of_pictures(run: Run) -> list[Finding]:
    """How far the agents' own pictures differ, how many attacks deceived, and the load of the radio channel."""
    pictures, channel = (run.files.summary.get(name, {}) for name in ("pictures", "channel"))
    result = []
    if pictures:
        deceived, apart = pictures["deceived"], pictures["difference_gospa_m"]["mean"]
        result.append(Finding("pictures", value=pictures["count"], other=apart, unit="m"))
        if deceived["first_s"] is not None:
            share, when = deceived["share"]["mean"] or 0.0, (deceived["first_s"],) * 2
            lies_from_s = deceived.get("lies_from_s")
            since = () if lies_from_s is None else (Finding("first lie", when=(lies_from_s,) * 2),)
            result.append(Finding("deceived", value=share, other=deceived["most"], when=when, parts=since))
        for what, each in pictures.get("consistency", {}).items():
            if each["above"]:
                result.append(Finding("overconfident", tuple(each["above"]), what, each["nees"], pictures["count"]))
    if channel:
        busy = channel["busy_ratio"]["mean"] or 0.0
        result.append(Finding("channel", what=str(channel["stations"]), value=busy, other=channel["sent"]))
        arrived = channel["arrived"]
        result.append(Finding("channel", what="arrived", value=arrived))
    return result
