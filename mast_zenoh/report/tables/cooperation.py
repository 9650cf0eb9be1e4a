"""The tables of the study that compares fusion architectures, and its conclusion."""

from __future__ import annotations

from mast_zenoh.metrics.significance import clearest
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
    whole_percent,
)

_ABOUT = (
    "Missed and false objects per frame in the ego's picture from the start of the attack on. Each trial with a lie is "
    "paired with the one without of the same scene and seed; 95 % intervals of Student's t over seeds."
)
_HARM = (
    *("architecture", "agents", "trials", "vehicles with sensors (%)", "errors without lies", "added by lies"),
    *("difference from the first", "agents deceived at a time (%)", "at most (%)"),
)
_TRAFFIC = (
    *("architecture", "agents", "kB/s an agent sends", "channel busy (%)", "between pictures (m, GOSPA)"),
    "NEES of positions (2 expected)",
)
_BRIEF = ("architecture", "agents", "errors", "added by lies", "deceived (%)", "kB/s")
_MEASURES = (
    "errors",
    "harm",
    "harm_difference",
    "deceived",
    "deceived_max",
    "nees",
    "gospa_m",
    "kb_per_s",
    "busy_ratio",
    "penetration",
)


def cooperation_tables(table: CooperationTable) -> ResultTables:
    """The tables of the study; the CSV has a row for each architecture, number of agents and measure."""
    harm = TextTable("Lies", "", _HARM, [_harm_line(row) for row in table.rows], 1)
    traffic = TextTable("Traffic and consistency, without lies", "", _TRAFFIC, [_line(row) for row in table.rows], 1)
    numbers = [
        [row.architecture, str(row.agents), name, *bounds(getattr(row, name))]
        for row in table.rows
        for name in _MEASURES
    ]
    summary = conclusion(table)
    brief = TextTable("Fusion architectures", summary, _BRIEF, [_brief_line(row) for row in table.rows], 1)
    note = FEW_TRIALS if any(row.trials < MIN_SEEDS for row in table.rows) else ""
    about = f"{table.size}. {summary} {_ABOUT}"
    headings = ("architecture", "agents", "measure", *BOUNDS)
    tables, title = [harm, traffic], "Fusion architectures"
    return ResultTables(title, about, table.size, tables, (headings, numbers), [brief], note, headline(table))


def headline(table: CooperationTable) -> str:
    """The clearest effect of lies; without a full stop. Empty: none, or too few trials for a test."""
    clear = clearest({index: row.harm for index, row in enumerate(table.rows)})
    for row in (table.rows[index] for index in clear):
        harm = measured(row.harm)
        return f"The clearest effect: with {row.architecture} and {row.agents} agents, lies add {harm} errors a frame"
    return ""


def conclusion(table: CooperationTable) -> str:
    """What lies do with most agents, by architecture, and whether that differs from the first one; "" without rows."""
    if not table.rows:
        return ""
    agents = max(row.agents for row in table.rows)
    first, *others = rows = [row for row in table.rows if row.agents == agents]
    harms = ", ".join(f"{row.architecture} {measured(row.harm)}" for row in rows)
    deceived = ", ".join(f"{row.architecture} {percent(row.deceived, ' %')}" for row in rows)
    clear = clearest({row.architecture: row.harm_difference for row in others})
    differ = [f"{row.architecture} (by {measured(row.harm_difference)})" for row in others if row.architecture in clear]
    alike = [row.architecture for row in others if row.architecture not in clear]
    sentences = [
        f"With {agents} agents, the lies add so many errors per frame to the ego's picture: {harms}.",
        f"Agents deceived at a time: {deceived}.",
        f"Different from {first.architecture}: {', '.join(differ)}." if differ else "",
        f"No difference from {first.architecture} is shown for {', '.join(alike)}." if alike else "",
    ]
    return " ".join(filter(None, sentences))


def _harm_line(row: CooperationRow) -> list[str]:
    return [
        *(row.architecture, str(row.agents), str(row.trials), _share(row.penetration), measured(row.errors)),
        *(measured(row.harm), measured(row.harm_difference), percent(row.deceived), percent(row.deceived_max)),
    ]


def _line(row: CooperationRow) -> list[str]:
    return [
        *(row.architecture, str(row.agents), number(row.kb_per_s.value, 1), _share(row.busy_ratio)),
        *(measured(row.gospa_m), measured(row.nees)),
    ]


def _brief_line(row: CooperationRow) -> list[str]:
    of_lies = measured(row.harm), percent(row.deceived)
    return [row.architecture, str(row.agents), number(row.errors.value), *of_lies, number(row.kb_per_s.value, 1)]


def _share(each: Measured) -> str:
    return whole_percent(each.value) if each.known else DASH
