"""Pages, the citation and the pictures agree with the package."""

import dataclasses
import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import pictures
import pytest
import yaml

from mast_zenoh import scenario
from mast_zenoh.attacks.adaptive import AdaptiveAttack, Lies, Moment
from mast_zenoh.config.registry import known_types
from mast_zenoh.evaluation.effects import EFFECTS
from mast_zenoh.integrity import Integrity
from mast_zenoh.launch import run as launcher
from mast_zenoh.metrics.causes import CAUSES
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.study.numbers import numbers

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


#: Required keys of the format, and the optional ones that a package can use.
REQUIRED = {"cff-version", "message", "title", "authors"}
OPTIONAL = {
    *("type", "abstract", "version", "license", "keywords", "date-released", "repository-code", "url", "references")
}


def test_the_citation_has_all_required_keys_and_agrees_with_the_package() -> None:
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["type"] == "software"
    assert REQUIRED <= CITATION.keys() <= REQUIRED | OPTIONAL
    lists = {"authors", "keywords", "references"}
    assert all(isinstance(CITATION[name], str) and CITATION[name] for name in CITATION.keys() - lists)
    assert CITATION["authors"], "at least one"
    for author in CITATION["authors"]:
        assert "name" in author or {"family-names", "given-names"} <= author.keys(), "an entity, or a person"
    assert (CITATION["version"], CITATION["license"]) == (PROJECT["version"], PROJECT["license"])
    assert PROJECT["name"] in CITATION["title"]
    assert len(set(CITATION["keywords"])) == len(CITATION["keywords"]), "the format allows no duplicates"


PAGE = (Path(__file__).parents[2] / "docs" / "explanation-defences.md").read_text(encoding="utf-8")
SHIPPED = {name: cls for name, cls in known_types(Integrity).items() if cls.__module__.startswith("mast_zenoh.")}
README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
COMMANDS = [
    *re.findall(r"^\$ mast run (\S+) (.*)$", PAGE, flags=re.M),
    *re.findall(r"/mast run (defended) (.*)$", README, flags=re.M),
]


def section(name: str) -> str:
    return PAGE.split(f"\n### {name}\n", 1)[1].split("\n### ", 1)[0]


def test_every_stage_has_a_section_with_what_it_catches_and_its_weaknesses() -> None:
    for name in SHIPPED.keys() - {"NoIntegrity"}:
        assert "*Catches*" in section(name)
        assert "*Weaknesses*" in section(name)


@pytest.mark.parametrize(("name", "words"), COMMANDS)
def test_every_run_of_the_page_and_of_the_readme_is_a_valid_scenario(name: str, words: str) -> None:
    path, content = scenario.load(name, [word for word in shlex.split(words) if word != "--set"])
    assert scenario.resolve(path, content, frames=2).nodes


DOCS = Path(__file__).parents[2] / "docs"
METRICS = (DOCS / "explanation-metrics-and-causes.md").read_text(encoding="utf-8")

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
    outcome = launcher.run(scenario.resolve(path, content, frames=40), folder / "run", runtime="inproc")
    assert outcome.error is None
    return outcome.folder


def named_in(text: str, heading: str) -> set[str]:
    """The names in the first column of the table below a heading."""
    part = re.split(r"\n##+ ", text.split(f"\n{heading}\n", 1)[1])[0]
    cells = [line.split("|")[1] for line in part.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_the_page_lists_all_effects() -> None:
    effects = named_in(METRICS, "### Effects on objects") | named_in(METRICS, "### Effects on messages")
    assert effects == set(EFFECTS)


def test_the_page_lists_all_causes_and_its_example_metric_is_measured(run: Path) -> None:
    section = METRICS.split("## Causes of errors")[1].split("### Cut off")[0]
    assert {cause for cause in CAUSES if f"`{cause}`" not in section} == set()
    assert "false_nearby" in read_table(run / "metrics.parquet")
    agents = json.loads((run / "metrics.json").read_text())["agents"]
    assert max(estimates["picture"]["false_nearby"]["mean"] for estimates in agents.values()) > 0.0


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


def test_every_block_of_the_metrics_that_a_study_reads_is_on_the_page() -> None:
    page = (
        (ROOT / "docs" / "how-to-studies.md")
        .read_text("utf-8")
        .split("Every number in these blocks of `metrics.json` becomes a row")[1]
    )
    table = page.split("\n\n")[1]
    blocks = dict(pictures=dict(deceived=dict(share=0.5)), channel=dict(busy_ratio=dict(mean=0.1, std=0.0)))
    for number in numbers(dict(agents={}, **blocks)):
        assert f"| `{number.owner}` | `{number.estimator}` |" in table, f"{number} is not on the page"


def test_all_that_an_adaptive_attack_gets_and_returns_is_on_the_page() -> None:
    page = (DOCS / "how-to-write-a-part.md").read_text("utf-8")
    section = page.split("### An attack that knows the defence")[1]
    documented = set(re.findall(r"`(\w+)", section.split("\n## ")[0]))
    moment = {field.name for field in dataclasses.fields(Moment)} | {"view", "time_s"}
    of_base = {name for name in vars(AdaptiveAttack) if name[0] != "_"} - {"bind", "hear_picture", "step", "lie"}
    assert {*moment, *(field.name for field in dataclasses.fields(Lies)), *of_base} <= documented


PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
SUFFIXES = (".png", ".svg", ".gif", ".jpg", ".webp", ".mp4", ".webm")


def references() -> dict[Path, list[tuple[str, str]]]:
    """By picture, the pages that show it, with its description."""
    found: dict[Path, list[tuple[str, str]]] = {}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert "<img" not in text, f"{page.name}: expected ![description](path)"
        for description, target in re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", text):
            found.setdefault((page.parent / target).resolve(), []).append((page.name, description))
    return found


def test_every_picture_has_a_recipe_a_page_and_a_description() -> None:
    files = {path for path in (ROOT / "docs").rglob("*") if path.suffix in SUFFIXES}
    shown = references()
    assert files == set(shown), "a picture that no page shows, or that does not exist"
    measured = {path for path in files if path.parent.name == "results"}  # `make results`
    recipes = {pictures.FOLDER / name for name in pictures.RECIPES}
    assert files - measured == recipes, "a picture without a recipe, or the reverse"
    for path, places in shown.items():
        for page, description in places:
            assert len(description) > 30, f"{page}: {path.name} needs a description for those who cannot see it"


def test_an_unknown_picture_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert pictures.main(["interception.png"]) == 2
    assert "recipe for 'interception.png'" in capsys.readouterr().err
