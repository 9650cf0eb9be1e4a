"""CSV and Parquet, read back by Python's csv module and pyarrow, hold every recorded number."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_record import CLASSES, PlainRecord, assert_same_boxes
from pyarrow import parquet

import mast_zenoh as mast

AXES = ("x", "y", "z", "l", "w", "h", "yaw")
DEVIATIONS = ("x", "y", "z", "l", "w", "h", "vx", "vy", "vz")


def csv_rows(path: Path) -> list[dict[str, Any]]:
    """The rows, with numbers as numbers, and None for what is empty."""
    text = ("agent", "estimate", "class", "outcome")
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: value if name in text else float(value) if value else None for name, value in row.items()}
            for row in csv.DictReader(file)
        ]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_the_table_holds_every_object_with_all_its_numbers(
    exported_to: Callable[[str], Path], record: PlainRecord, form: str
) -> None:
    out = exported_to(form)
    rows = csv_rows(out) if form == "csv" else parquet.read_table(out).to_pylist()
    by_name: dict[str, dict[int, list[dict[str, Any]]]] = {}
    for row in rows:
        name = ".".join(filter(None, (row["agent"], row["estimate"])))
        by_name.setdefault(name, {}).setdefault(int(row["frame"]), []).append(row)
        assert row["time_ns"] == record.times_ns[row["frame"]]
    assert set(by_name) == set(record.boxes)
    for name, frames in by_name.items():
        boxes = {
            frame: ([row["id"] for row in of], [[row[axis] for axis in AXES] for row in of])
            for frame, of in frames.items()
        }
        assert_same_boxes(boxes, record.boxes[name], 0.0)
        for frame, of in frames.items():
            columns = record.boxes[name][frame].columns
            of.sort(key=lambda row: row["id"])
            assert [[row[axis] for axis in ("vx", "vy", "vz")] for row in of] == columns["velocity"].tolist()
            assert [row["class"] for row in of] == [CLASSES[index] for index in columns["class_id"]]
            if name == "truth":
                assert [row["points"] for row in of] == columns["points"].max(axis=1).tolist()
                assert {row["score"] for row in of} | {row["std_x"] for row in of} == {None}
            else:
                assert [row["score"] for row in of] == columns["score"].tolist()
                deviations = np.array([[row[f"std_{name}"] for name in DEVIATIONS] for row in of])
                variances = np.diagonal(columns["covariance"], axis1=1, axis2=2)
                np.testing.assert_allclose(deviations**2, variances, rtol=1e-12)


def test_outcomes_of_the_table_are_those_of_the_evaluator(
    recorded: mast.Run, exported_to: Callable[[str], Path]
) -> None:
    rows = parquet.read_table(exported_to("parquet")).to_pylist()
    judged = recorded.objects.to_pylist()
    for agent, estimate, as_agent in (("", "picture", "ego"), ("infra_1", "received", "infra_1")):
        found = sorted(
            (row["frame"], row["id"], row["outcome"])
            for row in rows
            if (row["agent"], row["estimate"]) == (agent, estimate) and row["outcome"] != "unevaluated"
        )
        assert found == sorted(
            (row["frame"], row["id"], row["outcome"])
            for row in judged
            if (row["agent"], row["estimator"], row["kind"]) == (as_agent, estimate, "track")
        )
        assert {outcome for _, _, outcome in found} == {"matched", "false"}
