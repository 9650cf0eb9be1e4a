"""Writes tests/study/increments.csv: increments of the shipped study's attacks.

Tests of the intervals draw samples from it, so intervals are checked on the distribution of real outcomes.
Record it again when the attacks change (1,200 trials, about ten minutes on one core):

    mast study monte_carlo --trials 40 --set 'adversaries=[2]' --out OUT \\
        --set scenes=intersection:0,intersection:1,intersection:2,intersection:3,intersection:4,intersection:5,\\
    intersection:6,intersection:7,intersection:8,intersection:9
    python tools/record_increments.py OUT > tests/study/increments.csv
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

from pyarrow import parquet

METRICS = ("fp_iob", "fn_iob")
COLUMNS = ("configuration", "scene", "seed", "estimator", "metric", "value")


def main(study: Path) -> None:
    """Print false and missed objects per frame: a row per scene, a column per seed."""
    rows = parquet.read_table(study / "results.parquet", columns=list(COLUMNS)).to_pylist()
    increments: dict[tuple[str, str, str], dict[int, float]] = {}
    for row in rows:
        if row["metric"] in METRICS and row["estimator"] == "picture":
            key = row["configuration"], row["metric"], row["scene"]
            increments.setdefault(key, {})[row["seed"]] = row["value"]
    environment = json.loads((study / "study.json").read_text())["environment"]
    print(
        f"# written by tools/record_increments.py; mast-zenoh {environment['mast-zenoh']}, code {environment['code']}"
    )
    seeds = sorted({row["seed"] for row in rows})
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(["configuration", "metric", "scene", *seeds])
    for key, values in increments.items():
        writer.writerow([*key, *(f"{values[seed]:.4f}" for seed in seeds)])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
