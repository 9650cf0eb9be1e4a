"""docs/metrics.md and docs/effects.md describe run folders correctly."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh import scenario
from mast_zenoh.effects import EFFECTS
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.tables import read_table
from mast_zenoh.metrics.causes import CAUSES

DOCS = Path(__file__).parents[2] / "docs"
METRICS = (DOCS / "metrics.md").read_text(encoding="utf-8")
EFFECTS_PAGE = (DOCS / "effects.md").read_text(encoding="utf-8")

SCENARIO = """
from mast_zenoh.scenario import load

{metric}

def scenario():
    return dict(load("coordinated")[1]) | dict(evaluator=dict({options}))
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a scenario with the page's examples of metrics and driving."""
    (metric,) = re.findall(r"^```python\n(.*?)^```$", METRICS, flags=re.S | re.M)
    options = re.findall(r"`evaluator=dict\(((?:metrics|driving)=.*?)\)`", METRICS)
    assert len(options) == 2
    folder = tmp_path_factory.mktemp("pages")
    (folder / "mine.py").write_text(SCENARIO.format(metric=metric, options=", ".join(options)))
    path, content = scenario.load(str(folder / "mine.py"))
    outcome = launcher.run(scenario.resolve(path, content, frames=80), folder / "run", runtime="inproc")
    assert outcome.error is None
    return outcome.folder


def named_in(text: str, heading: str) -> set[str]:
    """The names in the first column of the table below a heading."""
    part = text.split(f"\n{heading}\n", 1)[1].split("\n## ", 1)[0]
    cells = [line.split("|")[1] for line in part.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_the_example_metric_is_in_the_summary_and_the_table(run: Path) -> None:
    table = read_table(run / "metrics.parquet")
    metrics = json.loads((run / "metrics.json").read_text())
    assert "false_nearby" in table
    of_agents = [estimates["picture"]["false_nearby"]["mean"] for estimates in metrics["agents"].values()]
    assert max(of_agents) > 0.0


def test_the_page_lists_all_columns_and_effects_of_attacks(run: Path) -> None:
    columns = set(read_table(run / "attacks.parquet"))
    documented = named_in(EFFECTS_PAGE, "## attacks.parquet")
    spelled_out = {f"{side}_{axis}" for side in ("before", "after") for axis in "xyz"}
    assert (documented - {"before_x", "after_z"}) | spelled_out == columns
    effects = named_in(EFFECTS_PAGE, "## Effects on objects") | named_in(EFFECTS_PAGE, "## Effects on messages")
    assert {name for name in effects if name != "columns"} == set(EFFECTS)


def test_the_page_lists_all_columns_of_the_tables(run: Path) -> None:
    for name in ("targets", "driving"):
        (documented,) = re.findall(rf"^`{name}\.parquet` has (.*?)\n\n", METRICS, flags=re.S | re.M)
        for column in read_table(run / f"{name}.parquet"):
            stem = column.removesuffix("_centre").removesuffix("_ego")
            assert re.search(rf"\b{stem}\b", documented), f"{name}.parquet: {column} is not on the page"


def test_the_page_lists_all_causes() -> None:
    section = METRICS.split("## Causes of errors")[1].split("## Cut off")[0]
    assert {cause for cause in CAUSES if f"`{cause}`" not in section} == set()


def test_achievements_and_consequences_for_driving_are_documented(run: Path) -> None:
    metrics = json.loads((run / "metrics.json").read_text())
    achieved: dict[str, Any] = metrics["achieved"]["all"]
    documented = named_in(METRICS, "## What an attack achieved")
    stems = {name.rstrip("…").removesuffix("_centre").rstrip("_") for name in documented} | {"inserted_frames"}
    for key in achieved:
        stem = key.removesuffix("_centre").removesuffix("_ego")
        assert stem in stems or stem.endswith("_frames"), f"achieved: {key} is not on the page"
    documented = {name.replace("…", "") for name in named_in(METRICS, "## What it would mean for driving")}
    for key in metrics["driving"]["ego"]["mission"]:
        assert key in documented or key.removesuffix("_attack") in documented, f"driving: {key} is not on the page"
