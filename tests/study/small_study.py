"""A small study: a baseline, two configurations, eight frames, two agents."""

from __future__ import annotations

from pathlib import Path

SMALL = """
def study(start_s=0.2, trials=2):
    place = dict(n_infrastructure=1)
    return dict(
        name="small",
        runs=dict(
            baseline=dict(scenario="baseline", parameters=place),
            attacked=dict(
                scenario="uncoordinated",
                parameters=place | dict(attack_start_s=start_s),
                grid=dict(n_adversaries=[1], false_positives=[5.0, 20.0]),
            ),
        ),
        scenes=["intersection:0"],
        trials=trials,
        frames=8,
    )
"""


def write_small(folder: Path) -> Path:
    """The study file."""
    path = folder / "small.py"
    path.write_text(SMALL)
    return path


TABLES = ("results.parquet", "frames.parquet", "table.csv", "table.md", "table.tex", "increments.png")


def tables(folder: Path) -> dict[str, bytes]:
    """The bytes of all tables of a study."""
    return {name: (folder / name).read_bytes() for name in TABLES}
