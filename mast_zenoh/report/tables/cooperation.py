"""The tables of the study that compares places of fusion, and its conclusion."""

from __future__ import annotations

from mast_zenoh.metrics.study_results import MIN_SEEDS, CooperationRow, CooperationTable, Measured
from mast_zenoh.report.tables.text_table import (
    BOUNDS,
    DASH,
    FEW_TRIALS,
    ResultTables,
    TextTable,
    bounds,
    measured,
    number,
    percent,
)

_ABOUT = (
    "Missed and false objects per frame in the ego's picture from the start of the attack on. Each trial with a lie is "
    "paired with the one without of the same scene and seed; bootstrap 95 % intervals over trials."
)
_HARM = (
    *("place", "agents", "trials", "cars with sensors (%)", "errors without lies", "more with lies"),
    *("that, minus the first place's", "agents deceived at a time (%)", "most at a time (%)"),
)
_TRAFFIC = (
    *("place", "agents", "kB/s an agent sends", "channel busy (%)", "between pictures (m, GOSPA)"),
    "NEES of positions (2 expected)",
)
_BRIEF = ("place", "agents", "errors", "more with lies", "deceived (%)", "kB/s")
_MEASURES = ("errors", "harm", "more", "deceived", "most", "nees", "gospa_m", "kb_per_s", "busy", "penetration")


def cooperation_tables(table: CooperationTable) -> ResultTables:
    """The tables of the study; the CSV has a row for each place, number of agents and measure."""
    harm = TextTable("Lies", "", _HARM, [_harm_line(row) for row in table.rows], 1)
    traffic = TextTable("Traffic and consistency, without lies", "", _TRAFFIC, [_line(row) for row in table.rows], 1)
    numbers = [
        [row.place, str(row.agents), name, *bounds(getattr(row, name))] for row in table.rows for name in _MEASURES
    ]
    said = conclusion(table)
    brief = TextTable("Places of fusion", said, _BRIEF, [_brief_line(row) for row in table.rows], 1)
    note = FEW_TRIALS if any(row.trials < MIN_SEEDS for row in table.rows) else ""
    about = f"{table.size}. {said} {_ABOUT}"
    headings = ("place", "agents", "measure", *BOUNDS)
    return ResultTables("Places of fusion", about, table.size, [harm, traffic], (headings, numbers), [brief], note)


def conclusion(table: CooperationTable) -> str:
    """What a lie does with most agents, by place, and whether that differs from the first place; "" without rows."""
    if not table.rows:
        return ""
    most = max(row.agents for row in table.rows)
    first, *others = rows = [row for row in table.rows if row.agents == most]
    harms = ", ".join(f"{row.place} {measured(row.harm)}" for row in rows)
    deceived = ", ".join(f"{row.place} {percent(row.deceived, ' %')}" for row in rows)
    differ = [f"{row.place} (by {measured(row.more)})" for row in others if row.more.differs_from_zero]
    alike = [row.place for row in others if not row.more.differs_from_zero]
    sentences = [
        f"With {most} agents, the lies add so many errors per frame to the ego's picture: {harms}.",
        f"Agents deceived at a time: {deceived}.",
        f"Different from {first.place}: {', '.join(differ)}." if differ else "",
        f"No difference from {first.place} is shown for {', '.join(alike)}." if alike else "",
    ]
    return " ".join(filter(None, sentences))


def _harm_line(row: CooperationRow) -> list[str]:
    return [
        *(row.place, str(row.agents), str(row.trials), _share(row.penetration), measured(row.errors)),
        *(measured(row.harm), measured(row.more), percent(row.deceived), percent(row.most)),
    ]


def _line(row: CooperationRow) -> list[str]:
    return [
        *(row.place, str(row.agents), number(row.kb_per_s.value, 1), _share(row.busy)),
        *(measured(row.gospa_m), measured(row.nees)),
    ]


def _brief_line(row: CooperationRow) -> list[str]:
    of_lies = measured(row.harm), percent(row.deceived)
    return [row.place, str(row.agents), number(row.errors.value), *of_lies, number(row.kb_per_s.value, 1)]


def _share(each: Measured) -> str:
    return number(100.0 * each.value, 0) if each.known else DASH
