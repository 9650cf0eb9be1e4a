"""Lays out a study's configurations in panels: curves, categories or a heat map."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mast_zenoh.report.tables.study_rows import StudyRow

#: Two numeric parameters with this many values each make a heat map instead of curves.
MIN_FOR_HEAT_MAP = 4

_UNITS = {"_s": "s", "_ms": "ms", "_m": "m", "_mps": "m/s", "_hz": "Hz", "_deg": "degrees", "_rad": "rad"}


@dataclass(frozen=True, slots=True)
class Curve:
    """The configurations of one line, in the order of x; label: empty if it is alone."""

    label: str
    rows: tuple[StudyRow, ...]


@dataclass(frozen=True, slots=True)
class Panel:
    """One row of panels, each of which shows one metric of the same configurations.

    title:   the run, and parameters that no axis shows
    x:       the parameter along the x axis, "" for the configurations' labels
    y:       of a heat map the other parameter, else ""
    ticks:   the values along x: numbers, or else the text of each, evenly spaced
    numeric: whether x is a number, so that neighbours may be joined
    curves:  of a heat map one per value of y
    """

    title: str
    x: str
    y: str
    ticks: tuple[object, ...]
    numeric: bool
    curves: tuple[Curve, ...]


def panels(rows: Sequence[StudyRow], baseline: str) -> list[Panel]:
    """All configurations but the baseline, each shown once.

    Runs that sweep the same one parameter share a panel, with a curve each. A run that sweeps two has its own, with a
    curve for each value of the second, or a heat map; one that sweeps more, a panel for each choice of the others. Of
    several parameters the numeric one with most values goes along x. Runs without a sweep share a separate panel.
    """
    runs: dict[str, list[StudyRow]] = {}
    for row in rows:
        if row.label != baseline:
            runs.setdefault(row.run, []).append(row)
    by_swept: dict[str, list[list[StudyRow]]] = {}
    several_swept: list[Panel] = []
    for run_rows in runs.values():
        swept = _swept(run_rows)
        if len(swept) < 2:
            by_swept.setdefault("".join(swept), []).append(run_rows)
        else:
            several_swept += _of_several(run_rows, swept)
    return [_of_one(x, runs_of_sweep) for x, runs_of_sweep in by_swept.items()] + several_swept


def _of_one(x: str, runs: Sequence[Sequence[StudyRow]]) -> Panel:
    """Runs that sweep the same parameter, or none."""
    rows = [row for run in runs for row in run]
    if not x:
        return Panel("", "", "", tuple(row.label for row in rows), False, (Curve("", tuple(rows)),))
    ticks, numeric = _ticks(rows, x)
    curves = tuple(Curve(run[0].run, _sorted(run, x, ticks)) for run in runs)
    return Panel("" if len(curves) > 1 else rows[0].run, x, "", ticks, numeric, curves)


def _of_several(rows: Sequence[StudyRow], swept: Sequence[str]) -> list[Panel]:
    """One run that sweeps two parameters or more."""
    sizes = {name: len(_ticks(rows, name)[0]) for name in swept}
    x = max(swept, key=lambda name: (_ticks(rows, name)[1], sizes[name]))
    second, *others = (name for name in swept if name != x)
    result = []
    for choice in dict.fromkeys(_choice(row, others) for row in rows):
        panel_rows = [row for row in rows if _choice(row, others) == choice]
        ticks, numeric = _ticks(panel_rows, x)
        values, numbers = _ticks(panel_rows, second)
        curves = tuple(
            Curve(
                f"{label_of(second)} = {text_of(value)}",
                _sorted([row for row in panel_rows if row.point[second] == value], x, ticks),
            )
            for value in values
        )
        heat = numeric and numbers and min(len(ticks), len(values)) >= MIN_FOR_HEAT_MAP
        title = ", ".join(
            [rows[0].run, *(f"{label_of(name)} = {value}" for name, value in zip(others, choice, strict=True))]
        )
        result.append(Panel(title, x, second if heat else "", ticks, numeric, curves))
    return result


def _swept(rows: Iterable[StudyRow]) -> list[str]:
    """The parameters of which a run has several values."""
    values: dict[str, set[str]] = {}
    for row in rows:
        for name, value in row.point.items():
            values.setdefault(name, set()).add(repr(value))
    return [name for name, each in values.items() if len(each) > 1]


def _ticks(rows: Iterable[StudyRow], name: str) -> tuple[tuple[object, ...], bool]:
    """The values of a parameter, numbers ascending; and whether they are numbers."""
    values = [row.point[name] for row in rows]
    if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values):
        return tuple(sorted(set(values), key=float)), True  # type: ignore[arg-type]
    return tuple({repr(value): value for value in values}.values()), False


def _sorted(rows: Iterable[StudyRow], x: str, ticks: Sequence[object]) -> tuple[StudyRow, ...]:
    return tuple(sorted(rows, key=lambda row: ticks.index(row.point[x])))


def _choice(row: StudyRow, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(text_of(row.point[name]) for name in names)


def label_of(parameter: str) -> str:
    """A parameter in words with its unit: `number of adversaries`, `attack start (s)`."""
    words = parameter.split(".")[-2:]
    unit = next((unit for suffix, unit in _UNITS.items() if words[-1].endswith(suffix)), "")
    if unit:
        words[-1] = words[-1].rpartition("_")[0]
    text = " ".join(words).replace("_", " ")
    text = f"number of {text.removeprefix('n ')}" if text.startswith("n ") else text
    return f"{text} ({unit})" if unit else text


def text_of(value: object) -> str:
    """A parameter's value: `0.5`, `5`, `in view`."""
    return f"{value:g}" if isinstance(value, float) else str(value)
