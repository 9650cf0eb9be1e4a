"""The table of scores: a row per metric and run, a column per estimate."""

import io
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from mast_zenoh.metrics.estimates import MAIN
from mast_zenoh.metrics.measures import metric_named
from mast_zenoh.run_folder.files import check_file
from mast_zenoh.show.tables.scores import OVER_ALONE, ScoreTable, score_table
from mast_zenoh.show.terminal import show

Counts = tuple[float, float, float]


def scores(values: Counts, **more: Any) -> dict[str, Any]:
    counts = {name: {"mean": value, "std": 0.5} for name, value in zip(("fn", "fp", "tp"), values, strict=True)}
    return counts | {"rmse_m": 0.31, "id_switches": 2} | more


def metrics(picture: Counts, local: Counts = (7.0, 0.5, 6.0), **others: dict[str, Any]) -> dict[str, Any]:
    return {
        "agents": {"ego": {"local": scores(local), "picture": scores(picture), "mission": scores(picture)} | others}
    }


RUNS = {"baseline": metrics((1.2, 0.25, 12.0)), "uncoordinated": metrics((1.5, 9.65, 11.7))}


def table_of(
    metrics: dict[str, Any], reference: str | None = None, counts: Mapping[str, Any] = MappingProxyType({})
) -> ScoreTable:
    """The table of runs with these metrics and counts."""
    runs: dict[str, Any] = {}
    for label, summary in metrics.items():
        files = SimpleNamespace(summary=summary, counts=counts.get(label))
        runs[label] = SimpleNamespace(ego="ego", files=files, scored_frames=summary.get("scored_frames"))
    return score_table(runs, reference)


def change(table: ScoreTable, key: str, run: str = "uncoordinated", estimate: str = "picture") -> float | None:
    return table.score(key, run, estimate).change


def printed(table: ScoreTable) -> str:
    page = io.StringIO()
    Console(file=page, width=80).print(table.as_rich())
    return page.getvalue()


def test_every_estimate_has_its_change_over_the_reference_and_the_picture_over_the_ego_alone() -> None:
    table = table_of(RUNS)
    assert change(table, "fp") == pytest.approx(9.4)
    assert change(table, "fn", estimate="mission") == pytest.approx(0.3)
    assert change(table, "fp", estimate="local") == 0.0
    assert change(table, "fp", run="baseline") is None
    assert table.score("fp", "uncoordinated", OVER_ALONE).mean == pytest.approx(9.15)


def test_the_reference_is_the_requested_run_or_the_baseline_or_the_first_run() -> None:
    assert table_of(dict(reversed(RUNS.items()))).reference == "baseline"
    assert table_of({"x": RUNS["baseline"], "y": RUNS["baseline"]}).reference == "x"
    assert table_of(RUNS, reference="uncoordinated").reference == "uncoordinated"
    assert table_of({"only": RUNS["baseline"]}).reference is None


def counts(fp: list[int], first: int = 0) -> dict[str, Any]:
    n = len(fp)
    return {
        "frame": np.tile(np.arange(first, first + n), 2),
        "agent": np.full(2 * n, "ego"),
        "estimator": np.repeat(["local", "picture"], n),
        "fn": np.zeros(2 * n, np.int64),
        "fp": np.array([0] * n + fp),
        "tp": np.ones(2 * n, np.int64),
    }


def test_counts_per_frame_give_the_spread_of_what_is_over_ego_alone_in_the_scored_frames() -> None:
    table = table_of(RUNS, counts={"baseline": counts([0, 1, 0]), "uncoordinated": counts([0, 4, 6])})
    assert table.score("fp", "uncoordinated", OVER_ALONE).std == pytest.approx(np.std([0, 4, 6]))
    runs = {label: summary | {"scored_frames": [1, 3]} for label, summary in RUNS.items()}
    table = table_of(runs, counts={"baseline": counts([9, 0, 1, 0]), "uncoordinated": counts([4, 6, 9], first=2)})
    assert table.score("fp", "uncoordinated", OVER_ALONE).std == pytest.approx(np.std([4, 6]))


def test_the_picture_in_transit_has_a_column_if_something_changed_it() -> None:
    """As it arrives, or, if nothing was late, as it is received."""

    def shown(change: dict[str, Any], **same: str) -> ScoreTable:
        changed = scores((1.2, 0.25, 12.0)) | change
        run = metrics((1.2, 0.25, 12.0), picture_received=changed, picture_on_arrival=changed)
        return table_of({"run": run | {"same_as": {"ego": same}}})

    late = shown({"rmse_m": 0.9}, picture_received="picture")
    assert late.estimates == ("local", "picture", "picture_on_arrival", "mission")
    assert shown({}, picture_received="picture", picture_on_arrival="picture").estimates == MAIN
    forged = shown({"fp": {"mean": 5.25, "std": 0.5}}, picture_received="picture_on_arrival")
    assert forged.estimates == ("local", "picture", "picture_received", "mission")
    assert forged.score("fp", "run", "picture_received").mean == 5.25


def test_estimates_of_a_users_own_wires_come_last_by_name() -> None:
    own = {name: scores((1.0, 0.0, 2.0)) for name in ("zebra", "intents", "hopes")}
    assert table_of({"run": metrics((1.2, 0.25, 12.0), **own)}).estimates == (*MAIN, "hopes", "intents", "zebra")


def test_what_a_received_folder_says_of_a_metric_is_checked() -> None:
    check_file({"own_metrics": {"price": {"digits": 3, "range": [0.0, None]}}}, "metrics.json")
    with pytest.raises(ValueError, match=r"own_metrics\.price\.digits: found 'many'"):
        check_file({"own_metrics": {"price": {"digits": "many"}}}, "metrics.json")
    known = metric_named("price", {"price": {"digits": 10**9, "unit": "EUR"}})
    assert (known.heading, known.digits) == ("price (EUR)", 17)


def test_markdown_has_a_line_per_metric_and_run_which_no_label_can_break() -> None:
    head, rule, *rows = table_of(RUNS).text().markdown().splitlines()
    assert {line.count("|") for line in (head, rule, *rows)} == {7}
    at = rows.index("| false (FP) | baseline | 0.50 ± 0.50 | 0.25 ± 0.50 | 0.25 ± 0.50 | \u22120.25 |")
    assert rows[at + 1] == (
        "| false (FP) | uncoordinated | 0.50 (+0.00) ± 0.50 | 9.65 (+9.40) ± 0.50 | 9.65 (+9.40) ± 0.50 | +9.15 |"
    )
    lines = table_of({"a|b\nc": RUNS["baseline"], "d": RUNS["baseline"]}).text().markdown().splitlines()
    assert lines[2].startswith("| missed (FN) | a\\|b c |")


def test_the_terminal_tables_fit_80_columns_and_one_run_has_no_changes() -> None:
    text = printed(table_of(RUNS | {"attack_during_partition": metrics((1.4, 2.2, 11.8))}))
    assert max(map(len, text.splitlines())) <= 80
    for number in ("9.65 (+9.40)", "12.00", "0.31"):
        assert number in text
    assert "…" not in text
    one = printed(table_of({"run": RUNS["baseline"]}))
    for heading in ("ego", "alone", "picture"):
        assert heading in one
    assert "(+" not in one


def test_the_terminal_shows_run_folders(three_runs: dict[str, Path]) -> None:
    (three_runs["coordinated"] / "metrics.json").write_text("{")
    page = io.StringIO()
    show(Console(file=page, width=80), three_runs)
    assert "6.25 (+6.25)" in page.getvalue()
    line = next(line for line in page.getvalue().splitlines() if "coordinated " in line and "unc" not in line)
    assert line.split()[-3:] == ["\u2013"] * 3
