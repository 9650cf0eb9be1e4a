"""docs/stone_soup.md works as written."""

from __future__ import annotations

import inspect
import re
import shlex
from pathlib import Path

import pytest

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.study import definition

pytest.importorskip("stonesoup", reason="Stone Soup is not installed")

from mast_zenoh.tracking import stone_soup_default

PAGE = (Path(__file__).parents[2] / "docs" / "stone_soup.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```python file=(\S+)\n(.*?)^```$", PAGE, flags=re.S | re.M))
COMMANDS = [shlex.split(line) for line in re.findall(r"^    mast (.*)$", PAGE, flags=re.M)]


def test_the_builder_of_the_page_tracks_objects(tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    run = mast.run(str(tmp_path / "singer.py"), frames=20, n_infrastructure=1, out=str(tmp_path / "run"))
    assert run.summary["agents"]["ego"]["local"]["tp"]["mean"] > 5.0


@pytest.mark.parametrize("command", [each for each in COMMANDS if each[:2] == ["run", "coordinated"]])
def test_the_commands_choose_the_tracker(command: list[str]) -> None:
    _, loaded = scenario.load("coordinated", [command[command.index("--set") + 1]])
    assert str(loaded).count("StoneSoupTracker") == 1


def test_the_options_of_the_default_tracker_are_listed_with_their_defaults() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| ([\d.]+)[^|]* \| [^|]+ \|$", PAGE, flags=re.M))
    parameters = inspect.signature(stone_soup_default.build).parameters
    assert {name: float(value) for name, value in rows.items()} == {
        name: float(parameter.default) for name, parameter in parameters.items()
    }


@pytest.mark.parametrize("settings", [each[3::2] for each in COMMANDS if each[:2] == ["study", "stone_soup"]])
def test_the_study_has_every_combination_of_tracker_and_attack(settings: list[str]) -> None:
    study = definition.load("stone_soup", settings)
    attacks, places = ("baseline", "coordinated"), ("mast", "agents", "everywhere")
    assert {each.label for each in study.configurations} == {f"{p}_{a}" for p in places for a in attacks}
    for each in study.configurations:
        name, _, attack = each.label.partition("_")
        chosen = [setting for setting in each.settings if not setting.startswith("scene=avstack")]
        path, loaded = scenario.load(each.scenario, chosen)
        assert path.stem == attack
        assert str(loaded).count("StoneSoupTracker") == {"mast": 0, "agents": 1, "everywhere": 2}[name]
