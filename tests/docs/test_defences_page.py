"""docs/defences.md agrees with the integrity stages, and its commands are valid."""

from __future__ import annotations

import ast
import inspect
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from mast_zenoh import scenario
from mast_zenoh.config.registry import known_types
from mast_zenoh.integrity import STATES, Integrity
from mast_zenoh.integrity.calibration import discoveries
from mast_zenoh.integrity.sequential import CONTRADICTION_TAIL, FALSE_ALARMS_PER_HOUR, OFFSET_TAIL

PAGE = (Path(__file__).parents[2] / "docs" / "defences.md").read_text(encoding="utf-8")
SHIPPED = {name: cls for name, cls in known_types(Integrity).items() if cls.__module__.startswith("mast_zenoh.")}
README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
COMMANDS = [
    *re.findall(r"^\$ mast run (\S+) (.*)$", PAGE, flags=re.M),
    *re.findall(r"/mast run (defended) (.*)$", README, flags=re.M),
]


def section(name: str) -> str:
    return PAGE.split(f"\n### {name}\n", 1)[1].split("\n### ", 1)[0]


@pytest.mark.parametrize("name", sorted(SHIPPED.keys() - {"NoIntegrity"}))
def test_every_stage_has_a_section_with_its_parameters_and_defaults(name: str) -> None:
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| [^|]*\| [^|]+ \|$", section(name), flags=re.M)
    documented = {parameter: ast.literal_eval(default) for parameter, default in rows}
    parameters = inspect.signature(SHIPPED[name]).parameters
    assert documented == {parameter: value.default for parameter, value in parameters.items()}
    assert "*Catches*" in section(name)
    assert "*Weaknesses*" in section(name)


def test_the_page_lists_all_states() -> None:
    assert re.findall(r"^\| `(\w+)` \| [^|]+ \| [^|]+ \|$", section("Trust"), flags=re.M) == list(STATES)


def test_the_readme_says_how_many_stages_there_are() -> None:
    numbers = ("seven", "eight", "nine", "ten", "eleven", "twelve")
    assert f"one of {numbers[len(SHIPPED) - 1 - 7]}\n" in README, "NoIntegrity does not count"


@pytest.mark.parametrize(("name", "words"), COMMANDS)
def test_every_run_of_the_page_and_of_the_readme_is_a_valid_scenario(name: str, words: str) -> None:
    path, content = scenario.load(name, [word for word in shlex.split(words) if word != "--set"])
    assert scenario.resolve(path, content, frames=2).nodes


def test_the_stated_alarm_limits_follow_from_the_calibrated_tails() -> None:
    (stated,) = re.findall(r"from ([\d.]+)\s+object-seconds .*? statistic\s+of\s+(\d+)\.", PAGE, flags=re.S)
    for tail, limit, step in zip((CONTRADICTION_TAIL, OFFSET_TAIL), map(float, stated), (0.01, 1.0), strict=True):
        for value, alarm in ((limit - step, False), (limit + step, True)):
            rates = tail.rate(np.array([value] + 9 * [0.0]))  # ten statistics, nine of them without evidence
            assert discoveries(rates, FALSE_ALARMS_PER_HOUR)[0] == alarm
