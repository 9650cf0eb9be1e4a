"""The summary table: one row per run, the same numbers everywhere."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from mast_zenoh.report import as_markdown, as_rich, summary_table
from mast_zenoh.report.terminal import show


def metrics(picture: tuple[float, float, float], local: tuple[float, float, float] = (7.0, 0.5, 6.0)) -> dict[str, Any]:
    def scores(values: tuple[float, float, float]) -> dict[str, Any]:
        counts = {name: {"mean": value, "std": 0.5} for name, value in zip(("fn", "fp", "tp"), values, strict=True)}
        return counts | {"rmse_m": 0.31, "id_switches": 2}

    return {"frames": 3, "agents": {"ego": {"local": scores(local), "picture": scores(picture)}}}


RUNS = {"baseline": metrics((1.2, 0.25, 12.0)), "uncoordinated": metrics((1.5, 9.65, 11.7))}


def test_increments_are_over_the_baseline_and_over_the_ego_alone() -> None:
    base, attacked = summary_table(RUNS)
    assert base.over_baseline is None
    assert attacked.over_baseline is not None
    assert [value.mean for value in attacked.over_baseline] == pytest.approx([0.3, 9.4])
    assert [value.mean for value in attacked.over_local] == pytest.approx([-5.5, 9.15])


def test_the_baseline_is_the_run_of_that_name_or_the_first_or_the_one_asked_for() -> None:
    backwards = dict(reversed(RUNS.items()))
    assert [row.over_baseline is None for row in summary_table(backwards)] == [False, True]
    assert [row.over_baseline is None for row in summary_table({"x": RUNS["baseline"], "y": RUNS["baseline"]})] == [
        True,
        False,
    ]
    assert [row.over_baseline is None for row in summary_table(RUNS, baseline="uncoordinated")] == [False, True]


def test_counts_per_frame_say_how_increments_spread() -> None:
    def table(fp: list[int]) -> dict[str, Any]:
        n = len(fp)
        return {
            "frame": np.tile(np.arange(n), 2),
            "agent": np.full(2 * n, "ego"),
            "estimator": np.repeat(["local", "picture"], n),
            "fn": np.zeros(2 * n, np.int64),
            "fp": np.array([0] * n + fp),
            "tp": np.ones(2 * n, np.int64),
        }

    counts = {"baseline": table([0, 1, 0]), "uncoordinated": table([0, 4, 6])}
    attacked = summary_table(RUNS, counts=counts)[1]
    assert attacked.over_baseline is not None
    assert attacked.over_baseline[1].std == pytest.approx(np.std([0, 3, 6]))
    assert attacked.over_local[1].std == pytest.approx(np.std([0, 4, 6]))


def test_what_is_not_known_is_a_dash() -> None:
    rows = summary_table({"baseline": {}, "uncoordinated": metrics((1.0, 2.0, 3.0)) | {"agents": {}}})
    lines = as_markdown(rows).splitlines()
    assert lines[2] == "| baseline |" + " \u2013 |" * 12


def test_markdown_has_a_line_per_run() -> None:
    head, rule, base, attacked = as_markdown(summary_table(RUNS)).splitlines()
    assert head.count("|") == rule.count("|") == base.count("|") == attacked.count("|")
    assert "| +9.40 | \u22125.50 | +9.15 |" in attacked


def test_a_label_cannot_break_the_markdown() -> None:
    lines = as_markdown(summary_table({"a|b\nc": RUNS["baseline"]})).splitlines()
    assert len(lines) == 3
    assert lines[2].startswith("| a\\|b c |")


def test_the_terminal_table_fits_80_columns() -> None:
    page = io.StringIO()
    Console(file=page, width=80).print(as_rich(summary_table(RUNS | {"coordinated": metrics((1.4, 2.2, 11.8))})))
    text = page.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    for number in ("9.65", "+9.40", "\u22125.50", "12.00", "0.31"):
        assert number in text
    assert "…" not in text


def test_of_one_run_the_terminal_shows_no_increments() -> None:
    page = io.StringIO()
    Console(file=page, width=80).print(as_rich(summary_table({"run": RUNS["baseline"]})))
    assert "over" not in page.getvalue().replace("mean over frames", "")


def test_the_terminal_shows_run_folders(three_runs: dict[str, Path]) -> None:
    (three_runs["coordinated"] / "metrics.json").write_text("{")
    page = io.StringIO()
    show(Console(file=page, width=80), three_runs)
    assert "6.25" in page.getvalue()
    line = next(line for line in page.getvalue().splitlines() if "coordinated " in line and "unc" not in line)
    assert line.split() == ["coordinated", *["\u2013"] * 8]


def test_increments_spread_over_the_frames_that_the_means_are_over() -> None:
    fp = np.array([0, 0, 0, 0, 9, 5, 7, 9])
    counts = {
        "frame": np.tile(np.arange(4), 2),
        "agent": np.full(8, "ego"),
        "estimator": np.repeat(["local", "picture"], 4),
        "fn": fp * 0,
        "fp": fp,
        "tp": fp * 0,
    }
    row = summary_table({"run": RUNS["baseline"] | {"scored_frames": [1, 2]}}, counts={"run": counts})[0]
    assert row.over_local[1].std == pytest.approx(1.0)
