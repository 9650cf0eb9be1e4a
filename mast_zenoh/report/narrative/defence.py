"""What a run's defence did, in one sentence."""

from __future__ import annotations

from typing import Any

from mast_zenoh.report.narrative.phrases import count, join_names
from mast_zenoh.report.runfolder import RunFolder

#: Agents that the sentence names.
_MOST_NAMES = 8


def defence_sentence(run: RunFolder) -> str:
    """Which agents the defence suspended, when, and what it withheld, as measured; empty: the run has no defence."""
    measured: dict[str, Any] = run.metrics.get("integrity", {})
    if not measured or run.defence == "NoIntegrity":
        return ""
    agents: dict[str, Any] = measured["agents"]
    suspended = [name for name, agent in agents.items() if agent["suspensions"]]
    missed = [name for name, agent in agents.items() if agent["lied"] and agent["suspended_after_s"] is None]
    did = [f"suspended {count(len(suspended))} agent{'s' if len(suspended) > 1 else ''}"]
    did += [_names([f"{name} ({_when(agents[name])})" for name in suspended])] if suspended else []
    did += [f"although {_names(missed)} lied"] if missed else []
    text = ", ".join(did)
    if "withheld" in measured:
        false, true = measured["withheld"]["false"], measured["withheld"]["true"]
        what = f"{false:.2f} false and {true:.2f} true objects a frame" if false or true else "nothing"
        text += f"{',' if len(did) > 1 else ''} and withheld {what}"
    return f"{run.defence or 'The defence'} {text}."


def _names(names: list[str]) -> str:
    """All names, or the first of many and the number of the others."""
    others = len(names) - _MOST_NAMES
    return join_names([*names[:_MOST_NAMES], f"{others} more"] if others > 0 else names)


def _when(agent: dict[str, Any]) -> str:
    """When an agent was suspended: `0.5 s after its first lie and while honest`."""
    delay_s = agent["suspended_after_s"]
    lying = [] if delay_s is None else [f"{delay_s:.1f} s after its first lie"]
    conducts = dict.fromkeys(each["conduct"] for each in agent["suspensions"])
    return " and ".join([*lying, *(f"while {conduct}" for conduct in conducts if not lying or conduct != "lying")])
