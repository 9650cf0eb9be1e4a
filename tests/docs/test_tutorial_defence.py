"""The tutorial on defences works as written, and its table is right."""

import json
import re
from pathlib import Path

import pytest
from page_commands import play_page

pytestmark = pytest.mark.heavy

PAGE = (Path(__file__).parents[2] / "docs" / "tutorial_defence.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which all files of the page were written and all its commands were run, in order."""
    return play_page(PAGE, tmp_path_factory.mktemp("defence"), least=9)


def picture(folder: Path, run: str, measure: str = "fp") -> float:
    """A mean per frame of the picture near the ego."""
    metrics = json.loads((folder / run / "metrics.json").read_text())
    return float(metrics["agents"]["ego"]["picture"][measure]["mean"])


@pytest.mark.timeout(300)
def test_every_file_and_command_of_the_page_works_as_written(folder: Path) -> None:
    printed = (folder / "printed").read_text()
    assert "4 passed" in printed
    assert printed.count("withheld objects per frame") == 2


def test_the_defence_stops_the_naive_adversary_and_not_the_one_that_knows_it(folder: Path) -> None:
    assert picture(folder, "naive_undefended") > 2.0
    assert picture(folder, "naive_defended") < 0.3 * picture(folder, "naive_undefended")
    assert picture(folder, "adaptive_undefended") > 1.0
    assert picture(folder, "adaptive_defended") > 0.9 * picture(folder, "adaptive_undefended")
    assert picture(folder, "quiet_defended", "fn") == picture(folder, "adaptive_undefended", "fn"), "it costs nothing"


def test_the_table_of_the_page_has_the_measured_numbers(folder: Path) -> None:
    rows = {"`UncoordinatedAttack`": "naive", "`FewWitnesses`": "adaptive"}
    for row, run in rows.items():
        (numbers,) = re.findall(rf"^\| {row} \| ([\d.]+) \| ([\d.]+) \|$", PAGE, flags=re.M)
        for defence, number in zip(("undefended", "defended"), numbers, strict=True):
            assert picture(folder, f"{run}_{defence}") == pytest.approx(float(number), abs=0.3)
    (quiet,) = re.findall(r"^\| none \| [\d.]+ \| ([\d.]+) \|$", PAGE, flags=re.M)
    assert picture(folder, "quiet_defended") == pytest.approx(float(quiet), abs=0.1)


def test_the_liar_is_trusted_less_only_if_it_is_naive(folder: Path) -> None:
    found = re.findall(r"^(\w+)_defended (\{.*\})$", (folder / "printed").read_text(), flags=re.M)
    trust = {run: json.loads(text.replace("'", '"')) for run, text in found}
    least = {run: min(values[agent] for agent in values if agent != "infra_1") for run, values in trust.items()}
    assert trust["naive"]["infra_1"] < least["naive"]
    assert trust["adaptive"]["infra_1"] >= least["adaptive"]
