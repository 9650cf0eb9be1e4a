"""Reports of faulted runs show faults, causes and checks; others none."""

import itertools
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from run_samples import edit
from table_writing import write_table

from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.over_time import causes_over_time, counts_over_time
from mast_zenoh.show.figures.timeaxis import Band, bands, lanes, place_bands
from mast_zenoh.show.html import write_report
from mast_zenoh.show.number_text import DASH
from mast_zenoh.show.tables.of_run import cause_table, check_lines, check_table, latency_tables

PARTITION = {"label": "Partition infra_1", "kind": "fault", "type": "Partition", "at_s": 0.5, "until_s": 1.5}
KILL = {"label": "Kill infra_2", "kind": "fault", "type": "Kill", "at_s": 1.0, "until_s": None}
ATTACK = {"label": "UncoordinatedAttack adversary_1", "kind": "attack", "type": "Attack", "at_s": 1.5, "until_s": None}
WIRELESS = {"label": "wireless_v2x ego", "kind": "link", "type": "wireless_v2x", "at_s": 0.0, "until_s": None}
CHECKS = {
    "checks": [
        {"name": "sequence numbers", "ok": True, "detail": "no hole in 400 messages", "values": {}},
        {"name": "processes", "ok": True, "detail": "not checked: one process", "values": {"checked": False}},
        {"name": "collation", "ok": False, "detail": "2 tracks <lost>", "values": {"lost": 2}},
    ],
    "heals_s": [1.5],
    "converged_after_s": 0.4,
}


def faulted(folder: Path, *timeline: dict[str, Any], checks: dict[str, Any] | None = None) -> Path:
    """Add faults to a run: timeline, causes, split, latency and checks."""
    split = {
        "fn_split": {"fault": 0.75, "attack": 0.25, "natural": 0.5},
        "fp_split": {"fault": 0.0, "attack": 7.5, "natural": 0.125},
    }
    by_wire = {"agent/ego/tracks": {"p50": 1.5, "p95": 2.5, "p99": 3.25, "n": 40}, "clock": {}}
    metrics = {"agents": {"ego": {"picture": split}}, "latency_ms": {"by_wire": by_wire}}
    edit(folder, scenario=timed(*timeline), metrics=metrics | {"late": {"ego": 0, "infra_1": 17}})
    table = read_table(folder / "objects.parquet")
    wrong = np.isin(table["outcome"], ("missed", "false")) & (table["estimator"] == "picture")
    cause = np.where(wrong, np.where(table["kind"] == "track", "inserted", "link or fault"), "")
    write_table(folder / "objects.parquet", table | {"cause": cause.astype(object)})
    if checks is not None:
        (folder / "checks.json").write_text(json.dumps(checks), "utf-8")
    return folder


def timed(*timeline: dict[str, Any]) -> dict[str, Any]:
    return {"timeline": list(timeline), "period_ns": 100_000_000}


@pytest.fixture
def attacked_and_faulted(run_folder: Callable[..., Path]) -> Path:
    return faulted(run_folder("uncoordinated"), PARTITION, KILL, ATTACK, checks=CHECKS)


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("attack", ["", "uncoordinated"])
def test_run_without_links_and_faults_has_no_such_sections(run_folder: Callable[..., Path], attack: str) -> None:
    folder = run_folder(attack)
    edit(folder, scenario=timed(*[ATTACK] if attack else []))
    run = Run(folder)
    assert not run.faulted
    assert bands([run], timed=True) == []
    assert causes_over_time(run, None) is None
    figure = counts_over_time({"run": run}, None)
    assert len(figure.axes) == 3
    page = write_report(folder).read_text("utf-8")
    for heading in ("Causes of missed and false objects", "Checks", "Latency"):
        assert f">{heading}</h2>" not in page
    content = re.sub(r"<(style|script)\b.*?</\1>|default", "", page, flags=re.DOTALL)
    assert "fault" not in content.partition("<body>")[2]


def test_bands_and_their_names_are_above_the_counts(attacked_and_faulted: Path) -> None:
    figure = counts_over_time({"run": Run(attacked_and_faulted)}, None)
    assert len(figure.axes) == 4
    assert {text.get_text() for text in figure.axes[0].texts} == {
        "Partition infra_1",
        "Kill infra_2",
        "UncoordinatedAttack adversary_1",
    }
    assert [text.get_text() for text in figure.legends[0].get_texts()][:2] == ["fault", "attack"]


def test_shared_band_of_compared_runs_is_shown_once(run_folder: Callable[..., Path]) -> None:
    runs = [
        Run(faulted(run_folder(), PARTITION)),
        Run(faulted(run_folder("coordinated"), PARTITION, ATTACK)),
    ]
    assert [band.label for band in bands(runs, timed=True)] == ["Partition infra_1", "UncoordinatedAttack adversary_1"]
    assert [(band.start, band.end) for band in bands(runs, timed=False)] == [(5.0, 15.0), (15.0, np.inf)]


def test_permanent_link_has_no_band(run_folder: Callable[..., Path]) -> None:
    run = Run(faulted(run_folder(), WIRELESS))
    assert run.faulted
    assert bands([run], timed=True) == []
    assert counts_over_time({"run": run}, None) is not None
    assert causes_over_time(run, None) is not None


def test_missed_objects_are_stacked_by_cause(attacked_and_faulted: Path) -> None:
    run = Run(attacked_and_faulted)
    figure = causes_over_time(run, 20)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["link or fault", "inserted"]
    counts = run.counts_of("picture")
    for axes, column in zip(figure.axes[1:], ("fn", "fp"), strict=True):
        (area,) = (each for each in axes.collections if each.get_label() in ("link or fault", "inserted"))
        assert area.get_paths()[0].vertices[:, 1].max() == counts[column].max() > 0


NAMES = (
    "",
    " ",
    "a",
    "Kill $x^{_1}",
    "Partition infra_1, infra_2, infra_3",
    "a name that is far too long to be shown as it is",
)
SOME_BANDS = st.lists(
    st.tuples(st.floats(0, 20), st.floats(0.01, 30), st.sampled_from(NAMES), st.booleans()), max_size=30
)


@given(SOME_BANDS)
def test_bands_and_labels_do_not_overlap(rows: list[tuple[float, float, str, bool]]) -> None:
    width, low, high = 10.0, 0.0, 20.0
    marked = sorted((Band(label, attack, at, at + lasts) for at, lasts, label, attack in rows), key=lambda b: b.start)
    bands_in_lanes, left_out = place_bands(marked, low, high, width)
    assert len(bands_in_lanes) + left_out == len(marked)
    for one, other in itertools.combinations(bands_in_lanes, 2):
        if one.lane == other.lane:
            assert min(one.band.end, high) <= other.band.start
    assert lanes(bands_in_lanes) <= 9


def test_simultaneous_faults_use_separate_lanes_and_surplus_is_counted() -> None:
    bands_in_lanes, left_out = place_bands([Band("Loss infra_1", False, 1.0, 5.0)] * 12, 0.0, 10.0, 10.0)
    assert [each.lane for each in bands_in_lanes] == list(range(9))
    assert left_out == 3


@pytest.mark.parametrize(
    ("start", "end", "x", "align"), [(1.0, 9.0, 1.07, "left"), (1.0, 1.2, 1.27, "left"), (9.5, 9.7, 9.43, "right")]
)
def test_a_name_is_inside_its_band_or_next_to_it(start: float, end: float, x: float, align: str) -> None:
    ((only,), _) = place_bands([Band("Kill infra_1", False, start, end)], 0.0, 10.0, 10.0)
    assert (only.x, only.align) == (pytest.approx(x), align)


def test_failed_checks_come_first_and_skipped_ones_last() -> None:
    assert check_table(CHECKS).lines[2] == ("processes", "not checked", "one process")
    assert check_table(CHECKS).bad == [True, False, False]
    assert [line.partition(":")[0] for line in check_lines(CHECKS)] == [
        "check collation",
        "check sequence numbers",
        "check processes",
    ]
    assert check_lines({}) == []


def test_missing_metrics_have_no_row() -> None:
    assert cause_table({"run": {}}).lines == []
    assert cause_table({"run": {"agents": {"ego": {"picture": {"fn": {"mean": 1.0}}, "local": {}}}}}).lines == []
    nothing = dict.fromkeys(("fault", "attack", "natural"))
    (line,) = cause_table({"run": {"agents": {"ego": {"picture": {"fn_split": nothing, "fp_split": nothing}}}}}).lines
    assert line == ("ego", *[DASH] * 6)
    assert [table.lines for table in latency_tables({"latency_ms": {"sim_to_picture": {"p50": 1.0}}})] == [[], [], []]
