"""The figures of a study in panels: increments over the baseline, and success rates."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import SubFigure

from mast_zenoh.metrics.estimates import LOCAL, MISSION, PICTURE
from mast_zenoh.metrics.study_results import MIN_SEEDS, Row, Statistic, StudyFacts, StudySeries
from mast_zenoh.show.figures.drawing import RenderedFigure, render
from mast_zenoh.show.figures.facets import Axis, colour_panel, facet
from mast_zenoh.show.figures.style import Figure, plain
from mast_zenoh.show.findings.words import of_study
from mast_zenoh.show.number_text import over_trials
from mast_zenoh.show.palette import INK

#: Two numeric parameters with this many values each make a heat map instead of curves.
MIN_FOR_HEAT_MAP = 4

_UNITS = {"_s": "s", "_ms": "ms", "_m": "m", "_mps": "m/s", "_hz": "Hz", "_deg": "degrees", "_rad": "rad"}


@dataclass(frozen=True, slots=True)
class Panel:
    """One row of panels, each of which shows one metric of the same configurations.

    title:   the run, and parameters that no axis shows
    x:       the parameter along the x axis, "" for the configurations' labels
    y:       of a heat map the other parameter, else ""
    ticks:   the values along x: numbers, or else the text of each, evenly spaced
    numeric: whether x is a number, so that neighbours may be joined
    curves:  by label (empty if it is alone) the configurations of one line, in the order of x; of a heat map one per
             value of y
    """

    title: str
    x: str
    y: str
    ticks: tuple[object, ...]
    numeric: bool
    curves: Mapping[str, Sequence[Row]]


def panels(rows: Sequence[Row], baseline: str) -> list[Panel]:
    """All configurations but the baseline, each shown once.

    Runs that sweep the same one parameter share a panel, with a curve each. A run that sweeps two has its own, with a
    curve for each value of the second, or a heat map; one that sweeps more, a panel for each choice of the others. Of
    several parameters the numeric one with most values goes along x. Runs without a sweep share a separate panel.
    """
    by_run: dict[str, list[Row]] = {}
    for row in rows:
        if row.configuration != baseline:
            by_run.setdefault(row.run, []).append(row)
    by_panel: dict[tuple[str, str, str], list[Row]] = {}  # by title, x, and the parameter by which curves differ
    for run, run_rows in by_run.items():
        swept = _swept(run_rows)
        x = max(swept, key=lambda name: (_ticks(run_rows, name)[1], len(_ticks(run_rows, name)[0])), default="")
        second, *others = [name for name in swept if name != x] or [""]
        for row in run_rows:
            choice = [f"{label_of(name)} = {text_of(row.of[name])}" for name in others]
            title = ", ".join([run, *choice]) if second else ""
            by_panel.setdefault((title, x, second), []).append(row)
    several_last = sorted(by_panel.items(), key=lambda item: bool(item[0][2]))
    return [_panel(*of, panel_rows) for of, panel_rows in several_last]


def _panel(title: str, x: str, second: str, rows: Sequence[Row]) -> Panel:
    """A panel of curves by the values of a second parameter, or by run."""
    if not x:
        return Panel("", "", "", tuple(row.configuration for row in rows), False, {"": rows})
    ticks, numeric = _ticks(rows, x)
    values, numbers = _ticks(rows, second) if second else ((), False)
    curves: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: values.index(row.of[second]) if second else 0):
        label = f"{label_of(second)} = {text_of(row.of[second])}" if second else row.run
        curves.setdefault(label, []).append(row)
    for curve in curves.values():
        curve.sort(key=lambda row: ticks.index(row.of[x]))
    heat = numeric and numbers and min(len(ticks), len(values)) >= MIN_FOR_HEAT_MAP
    alone = rows[0].run if len(curves) == 1 else ""
    return Panel(title or alone, x, second if heat else "", ticks, numeric, curves)


def _swept(rows: Iterable[Row]) -> list[str]:
    """The parameters of which a run has several values."""
    values: dict[str, set[str]] = {}
    for row in rows:
        for name, value in row.point.items():
            values.setdefault(name, set()).add(repr(value))
    return [name for name, each in values.items() if len(each) > 1]


def _ticks(rows: Iterable[Row], name: str) -> tuple[tuple[object, ...], bool]:
    """The values of a parameter, numbers ascending; and whether they are numbers."""
    values = [row.of[name] for row in rows]
    if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values):
        return tuple(sorted(set(values), key=float)), True
    return tuple({repr(value): value for value in values}.values()), False


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


#: A range of positive values with more than this ratio is drawn on a logarithmic axis.
_LOG_FROM = 50.0

#: Inches of a label of configurations that are below each other.
_LINE = 0.25

_ADDED = "more than in the baseline"
_OVER_SEEDS = "95 % interval over seeds of these scenes"


_PER_FRAME = f"{_ADDED}, per frame"
#: The axes of the figures of increments, by file name.
_INCREMENTS: dict[str, Sequence[Axis]] = {
    "increments": (
        Axis(StudySeries("", PICTURE, "fp_iob"), _PER_FRAME, title="False objects: picture"),
        Axis(StudySeries("", PICTURE, "fn_iob"), _PER_FRAME, title="Missed objects: picture"),
        Axis(StudySeries("compromised", LOCAL, "cafp_iob"), _PER_FRAME, title="False objects: compromised agents"),
    ),
    "increments_mission": [
        Axis(StudySeries("", MISSION, metric), label, title=f"{title}: ego with the picture")
        for title, label, metric in (
            ("False objects", _PER_FRAME, "fp_iob"),
            ("Missed objects", _PER_FRAME, "fn_iob"),
            ("Identity switches", f"{_ADDED}, per run", "id_switches_iob"),
        )
    ],
}
_CAPTIONS = {
    "increments": "What each configuration adds to the picture",
    "increments_mission": "What each configuration adds to what the ego acts on: its own tracks and the picture "
    "together",
    "success": "In how many trials the attacks of each configuration succeeded; without adversaries none can",
}


def figures_over_trials(rows: Sequence[Row], facts: StudyFacts) -> dict[str, RenderedFigure]:
    """The figures by file name, without empty ones."""
    all_panels = panels(rows, facts.baseline)
    rows = [row for row in rows if row.configuration != facts.baseline]
    rates = dict.fromkeys(series for row in rows for series, each in row.numbers.items() if each.rate)
    # Of all adversaries together, at most three.
    success = [
        Axis(series, "success rate (%)", 100.0, title=series.metric.replace("_", " "))
        for series in rates
        if series.owner == "all"
    ][:3]
    pictures = {}
    for name, axes in (*_INCREMENTS.items(), ("success", success)):
        estimates = {axis: [each for row in rows if (each := row.get(axis.measure)).seeds] for axis in axes}
        axes = [axis for axis, of_axis in estimates.items() if of_axis]
        if not (axes and all_panels):
            continue
        known = [each for of_axis in estimates.values() for each in of_axis]
        how = "Clopper-Pearson, effective number of trials" if name == "success" else "Student's t"
        seeds, scenes = sorted({each.seeds for each in known}), sorted({each.scenes for each in known})
        (footer,) = of_study("footer", seeds=seeds, scenes=scenes, interval=f"{_OVER_SEEDS} ({how})", **_bars(known))
        if any(panel.y for panel in all_panels):
            footer += "; in brackets where it contains 0 or there is none"
        own = any(axis.measure.owner == "compromised" for axis in axes)
        about = f"{_CAPTIONS[name]}{', and to the own tracks of the compromised agents' * own}."
        caption = " ".join([about, *(of_study("bar_notes", **_bars(known)) if name in _INCREMENTS else [])])
        of_first = [(row.configuration, row.get(axes[0].measure)) for row in rows]
        values = "; ".join(f"{label} {over_trials(each)}" for label, each in of_first if each.seeds)
        alt = f"{axes[0].title}, {axes[0].label}: {values}."
        pictures[name] = render(name, _draw(all_panels, axes, footer), alt, caption, printed=True)
    return pictures


def _bars(known: Sequence[Statistic]) -> dict[str, bool]:
    """Whether any estimate has an interval, and why others have none: too few seeds, all seeds equal, most trials 0."""
    bare = [each for each in known if math.isnan(each.low)]
    return {
        "any": len(bare) < len(known),
        "few": any(each.seeds < MIN_SEEDS for each in bare),
        "equal": any(each.seeds >= MIN_SEEDS and (each.unchanged or each.certain) for each in bare),
        "zero": any(each.mostly_zero and not each.unchanged for each in bare),
    }


def _draw(all_panels: Sequence[Panel], columns: Sequence[Axis], footer: str) -> Figure:
    """A row of axes per panel, one for each of `columns`.

    Heat maps of a column share their colour scale.
    """
    width = 11.25
    heights = [
        max(3.75, _LINE * len(panel.ticks) * (not panel.numeric)) + 0.25 * bool(panel.title) for panel in all_panels
    ]
    figure = Figure(figsize=(width, sum(heights) + 0.3), layout="constrained", facecolor="white")
    strips = figure.subfigures(len(all_panels), 1, height_ratios=heights, squeeze=False)[:, 0]
    all_rows = [row for panel in all_panels for curve in panel.curves.values() for row in curve]
    for strip, panel in zip(strips, all_panels, strict=True):
        if not panel.y:
            _curves(strip, panel, columns)
            continue
        for axes, column in zip(strip.subplots(1, len(columns), squeeze=False)[0], columns, strict=True):
            sizes = [abs(row.get(column.measure).value) for row in all_rows if row.get(column.measure).seeds]
            _heat_map(axes, panel, column.measure, max(sizes, default=0.0) or 1.0)
            axes.set_title(f"{column.title}\n{column.label}", fontsize=9.5, color=INK, loc="left")
            axes.set_xlabel(plain(label_of(panel.x)), fontsize=9.5, color=INK)
            axes.set_ylabel(plain(label_of(panel.y)), fontsize=9.5, color=INK)
        if panel.title:
            strip.suptitle(plain(panel.title), fontsize=10.5, fontweight="bold", color=INK, x=0.01, ha="left")
    figure.supxlabel(textwrap.fill(footer, int(12 * width)), fontsize=8.5, color=INK)
    return figure


def _curves(strip: SubFigure, panel: Panel, columns: Sequence[Axis]) -> None:
    """A panel for each column, with one curve per run or value; texts are on lines below each other."""
    rows = [
        Row(
            {"x": row.of[panel.x or "configuration"] if panel.numeric else text_of(row.of[panel.x or "configuration"])}
            | {"curve": label},
            0,
            {column.measure: row.get(column.measure) for column in columns},
        )
        for label, curve in panel.curves.items()
        for row in curve
    ]
    for column in columns:
        rate = any(row[column.measure].rate for row in rows)
        # No adversary, no success.
        if rate and panel.x.rpartition(".")[2] == "n_adversaries" and panel.numeric and 0 not in panel.ticks:
            nothing = {each.measure: Statistic(value=0.0) for each in columns}
            rows.append(Row({"x": 0, "curve": ""}, 0, nothing))
    numbers = [float(row.of["x"]) for row in rows] if panel.numeric else []
    wide = len(panel.ticks) > 2 and min(numbers, default=0.0) > 0.0 and max(numbers) / min(numbers) >= _LOG_FROM
    label = plain(label_of(panel.x)) if panel.numeric else ""
    facet(rows, "x", columns, "curve", label=label, log=wide, into=strip, title=plain(panel.title))


def _heat_map(axes: Axes, panel: Panel, measure: object, scale: float) -> None:
    """Means as colours and numbers, in brackets if the interval contains 0 or is none."""
    cells, curves = list[list[Row | None]](), [*panel.curves.items()][::-1]
    for _, curve in curves:
        rows = {row.of[panel.x]: Row({}, 0, {measure: row.get(measure)}) for row in curve}
        cells.append([rows.get(tick) for tick in panel.ticks])

    def text(each: Statistic) -> str:
        size = f"{100 * each.value:.0f}" if each.rate else f"{each.value:.3g}"
        return (size if each.low > 0.0 or each.high < 0.0 else f"({size})").replace("-", "\u2212")

    colour_panel(axes, cells, measure, Normalize(-scale, scale), text, 9.0)
    axes.set_xticks(range(len(panel.ticks)), [plain(text_of(tick)) for tick in panel.ticks])
    axes.set_yticks(range(len(curves)), [plain(label.partition(" = ")[2]) for label, _ in curves])
