"""The tables of a matrix of defences: text, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence

from rich.console import Group
from rich.table import Table

from mast_zenoh.report.defence_rows import MEASURES, DefenceMatrix, DefenceRow, DelayCurve
from mast_zenoh.report.tables.scores import DASH
from mast_zenoh.report.tables.study_rows import Estimate, number, over_trials

#: Measures of the table of costs: what a defence does without an attack.
_COSTS = ("fn_added", "fp_added", "ospa_added_m", "honest_suspended_per_hour")
_NUMBERS = ("trial_mean", "low", "high", "scenes_low", "scenes_high")


def as_markdown(matrix: DefenceMatrix) -> str:
    """All tables as Markdown."""
    parts = [
        "# Defences against adversaries",
        f"{matrix.size}. Means over trials with 95 % intervals over seeds; differences are paired by scene and seed.",
        "## Cost without an attack",
        "Compared with no defence, per frame.",
        _table(["defence", *(MEASURES[name] for name in _COSTS)], _costs(matrix)),
        "## Damage",
        "Missed and false objects added per frame to the ego's picture, compared with no attack and no defence.",
        *_damage(matrix),
        "## Detection",
        "Lies that an honest agent could notice, and whether their object was withheld or their agent suspended; "
        "s from the first of them to the suspension of its agent.",
        _table(
            ["defence", "adversary", "n", "placement", "budget", *_detection_headings()],
            [_detection(row) for row in matrix.rows if row.delay and row.defence in matrix.delays],
        ),
        *_faults(matrix),
        "## Honest, faulty or lying",
        "Share of the time in which agents were in each state of trust, in per cent.",
        _table(*_confusion(matrix)),
        "## Suspicion",
        "One score for each agent and run: its greatest suspicion.",
        _table(["defence", "AUC", "partial AUC below 1 false alarm/h", "hours"], _characteristics(matrix)),
    ]
    return "\n\n".join(parts) + "\n"


def as_rich(matrix: DefenceMatrix) -> Group:
    """The damage in the colours of the terminal, a table for each placement."""
    parts = []
    for placement, headings, lines in _damage_tables(matrix):
        table = Table(title=f"Missed and false objects added per frame, placement {placement}", title_justify="left")
        for index, heading in enumerate(headings):
            table.add_column(heading, justify="left" if index == 0 else "right")
        for line in lines:
            table.add_row(*line)
        parts.append(table)
    return Group(*parts)


def as_csv(matrix: DefenceMatrix) -> str:
    """All estimates with all digits: a row per cell and measure; empty where unknown."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    cell = ("defence", "attack", "n_adversaries", "placement", "budget", "budgets")
    names = ("mean", *_NUMBERS[1:])
    writer.writerow([*cell, "measure", *names, "scenes", "seeds", "seeds_left_out"])
    for row in matrix.rows:
        place = ["" if getattr(row, name) is None else getattr(row, name) for name in cell]
        for name in MEASURES:
            estimate = row.estimates.get(name, Estimate())
            values = [_digits(getattr(estimate, field)) for field in _NUMBERS]
            writer.writerow([*place, name, *values, estimate.scenes, estimate.seeds, estimate.left_out])
        if row.delay is not None:
            values = [_digits(row.delay.median_s), "", "", "", ""]
            writer.writerow([*place, "median_delay_s", *values, "", "", ""])
        for conduct, states in row.confusion.items():
            for state, seconds in states.items():
                writer.writerow([*place, f"seconds {conduct} {state}", _digits(seconds), "", "", "", "", "", "", ""])
    return buffer.getvalue()


def as_latex(matrix: DefenceMatrix) -> str:
    """LaTeX tabulars of the damage, one for each placement; need no LaTeX package."""
    size = matrix.size.replace("\u00d7", "x")
    parts = [f"% missed and false objects added per frame [95 % interval over seeds]; {size}"]
    for placement, headings, lines in _damage_tables(matrix):
        parts += [
            f"% placement: {placement}",
            r"\begin{tabular}{ll" + "r" * (len(headings) - 2) + "}",
            r"\hline",
            " & ".join(map(_tex, headings)) + r" \\",
            r"\hline",
            *(" & ".join(map(_tex, line)) + r" \\" for line in lines),
            r"\hline",
            r"\end{tabular}",
        ]
    return "\n".join([*parts, ""])


def _damage(matrix: DefenceMatrix) -> Iterator[str]:
    for placement, headings, lines in _damage_tables(matrix):
        yield f"Placement of the adversaries: {placement}."
        yield _table(headings, lines)


def _damage_tables(matrix: DefenceMatrix) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    """Placement, headings and lines: a line per adversary and number, a column per defence."""
    defences = matrix.names("defence")
    for placement in matrix.names("placement"):
        lines = []
        for attack in matrix.names("attack"):
            for count in matrix.names("n_adversaries"):
                rows = [matrix.row(defence, attack, count, placement) for defence in defences]
                if any(row is not None for row in rows):
                    lines.append([str(attack), str(count), *(_text(row, "damage") for row in rows)])
        yield str(placement), ["adversary", "n", *map(str, defences)], lines


def _costs(matrix: DefenceMatrix) -> list[list[str]]:
    return [[row.defence, *(_text(row, name) for name in _COSTS)] for row in matrix.rows if not row.attack]


def _faults(matrix: DefenceMatrix) -> list[str]:
    """The table of suspensions of faulty agents; [] without any."""
    rows = [row for row in matrix.rows if any(row.confusion.get("faulty", {}).values())]
    if not rows:
        return []
    names = ("faulty_suspended_per_hour", "honest_suspended_per_hour", "ospa_added_m")
    lines = [
        [row.defence, row.attack or DASH, str(row.n_adversaries), *(_text(row, name) for name in names)] for row in rows
    ]
    text = "Agents with a natural fault that did not lie."
    return ["## Faults", text, _table(["defence", "attack", "n", *(MEASURES[name] for name in names)], lines)]


def _detection_headings() -> list[str]:
    names = ("lies_detected", "honest_suspended_per_hour", "fp_identifiable", "fp_unidentifiable")
    return [*(MEASURES[name] for name in names), "median delay (s)", "suspended"]


def _detection(row: DefenceRow) -> list[str]:
    names = ("lies_detected", "honest_suspended_per_hour", "fp_identifiable", "fp_unidentifiable")
    budget = DASH if row.budget is None else f"{row.budget:g}"
    delay = [_median(row.delay), f"{row.delay.detections} of {row.delay.watched}"] if row.delay else [DASH, DASH]
    place = [row.defence, row.attack, str(row.n_adversaries), row.placement, budget]
    return [*place, *(_text(row, name) for name in names), *delay]


def _median(delay: DelayCurve) -> str:
    if not math.isnan(delay.median_s):
        return number(delay.median_s)
    return f"> {number(float(delay.time_s[-1]), 1)}"


def _confusion(matrix: DefenceMatrix) -> tuple[list[str], list[list[str]]]:
    """Headings and lines: the shares of states for each defence and conduct, over all its cells."""
    states: list[str] = []
    lines = []
    for defence in matrix.names("defence"):
        sums: dict[str, dict[str, float]] = {}
        for row in matrix.rows:
            for conduct, seconds in row.confusion.items() if row.defence == defence else ():
                total = sums.setdefault(conduct, {})
                for state, value in seconds.items():
                    total[state] = total.get(state, 0.0) + value
        for conduct, seconds in sums.items():
            states = list(seconds)
            whole = sum(seconds.values())
            if whole:
                shares = (number(100.0 * value / whole, 1) for value in seconds.values())
                lines.append([str(defence), conduct, *shares, number(whole / 3600.0, 3)])
    return ["defence", "conduct", *states, "agent-hours"], lines


def _characteristics(matrix: DefenceMatrix) -> list[list[str]]:
    return [
        [each.defence, number(each.auc, 3), number(each.partial_auc, 3), number(each.hours, 3)] for each in matrix.rocs
    ]


def _text(row: DefenceRow | None, name: str) -> str:
    return DASH if row is None else over_trials(row.estimates.get(name, Estimate()))


def _table(headings: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table; text columns come first."""
    rows = [headings, ["---"] * len(headings), *lines]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _digits(value: float) -> str:
    return "" if math.isnan(value) else repr(float(value))


def _tex(text: str) -> str:
    for character, replacement in (("\u2212", "$-$"), (DASH, "--"), ("_", r"\_"), ("%", r"\%"), ("&", r"\&")):
        text = text.replace(character, replacement)
    return text.replace("<", "$<$")
