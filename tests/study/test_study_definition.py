"""Study files are read; invalid entries are refused by name."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.study import definition


@pytest.fixture
def load(tmp_path: Path):
    def load(content: Any, *settings: str) -> definition.Study:
        path = Path(tempfile.mkdtemp(dir=tmp_path)) / "mine.py"  # a file is executed once
        path.write_text(f"def study(n=2):\n    return {content!r}\n")
        return definition.load(str(path), settings)

    return load


def runs(**more: Any) -> dict[str, Any]:
    return {"runs": {"baseline": {"scenario": "baseline"}, "attacked": {"scenario": "uncoordinated", **more}}}


def test_a_grid_becomes_a_configuration_for_each_point(load) -> None:
    study = load(runs(parameters={"scene_index": 3}, grid={"n_adversaries": [1, 2], "false_positives": [0.5]}))
    assert [each.label for each in study.configurations] == ["baseline", "attacked-1-0.5", "attacked-2-0.5"]
    last = study.configurations[-1]
    assert last.settings == ("scene_index=3", "n_adversaries=2", "false_positives=0.5")
    assert (last.run, last.point) == ("attacked", (("n_adversaries", 2), ("false_positives", 0.5)))


def test_baseline_is_the_configured_one_or_named_baseline_or_the_first(load) -> None:
    assert load(runs()).baseline == "baseline"
    assert load(runs() | {"baseline": "attacked"}).baseline == "attacked"
    assert load({"runs": {"plain": {"scenario": "baseline"}}}).baseline == "plain"


def test_scenes_are_short_names_or_parameters(load) -> None:
    study = load(runs() | {"scenes": ["avstack:data/a", {"scene": "intersection", "scene_index": 4}]})
    assert [place.label for place in study.scenes] == ["avstack:data/a", "intersection, 4"]
    assert study.scenes[1].settings == ("scene=intersection", "scene_index=4")
    assert [place.settings for place in load(runs()).scenes] == [()]


def test_scenes_with_equal_values_are_labelled_with_keys(load) -> None:
    study = load(runs() | {"scenes": [{"scene": "a", "n_mobile": 1}, {"scene": "a", "scene_index": 1}]})
    assert [place.label for place in study.scenes] == ["scene=a, n_mobile=1", "scene=a, scene_index=1"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (3, r"must return a dict with `runs`"),
        ({"runs": {}}, r"must return a dict with `runs`"),
        (runs() | {"trails": 3}, r"trails: unknown key; did you mean 'trials'"),
        (runs(gird={}), r"runs\.attacked\.gird: unknown key; did you mean 'grid'"),
        (runs(grid={"n": 3}), r"runs\.attacked\.grid\.n: found 3, expected a list of values"),
        (runs(grid=[1]), r"runs\.attacked\.grid: found \[1\], expected a dict"),
        (runs() | {"baseline": "atacked"}, r"baseline: found 'atacked'; did you mean 'attacked'"),
        (runs() | {"scenes": []}, r"scenes: found \[\], expected a list"),
        (runs() | {"scenes": [3]}, r"scenes\[0\]: found 3, expected a short name or a dict"),
        (
            runs(grid={"scene": ["a"]}),
            r"grid\.scene: the tables of results have a column .*; list scenes under `scenes`",
        ),
        (runs(grid={"metric": [1]}), r"runs\.attacked\.grid\.metric: the tables of results have a column of this name"),
        (
            runs() | {"scenes": ["a", "b", "a"]},
            r"scenes\[2\]: the same as scenes\[0\] \(scene=a\), expected each .* once",
        ),
        (runs() | {"trials": 0}, r"trials: found 0, expected a whole number from 1"),
        (runs() | {"trials": 2.5}, r"trials: found 2.5, expected a whole number from 1"),
        (runs() | {"seed": -1}, r"seed: found -1, expected a whole number from 0"),
        (runs() | {"runtime": "cloud"}, r"runtime: found 'cloud'; known: inproc, mesh"),
        ({"runs": {"a/b": {"scenario": "baseline"}}}, r"found the label 'a/b', expected one that can name a folder"),
    ],
)
def test_invalid_values_are_named_with_their_key(load, content: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"mine\.py: .*{message}"):
        load(content)


def test_two_configurations_cannot_have_one_label(load) -> None:
    one = {"scenario": "uncoordinated", "grid": {"n_adversaries": [1]}}
    with pytest.raises(ConfigurationError, match="two configurations are called 'a-1'"):
        load({"runs": {"a": one, "a-1": {"scenario": "baseline"}}})


def test_an_error_in_the_function_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def study():\n    return 1 / 0\n")
    with pytest.raises(ConfigurationError, match=r"mine\.py: study\(\.\.\.\): ZeroDivisionError"):
        definition.load(str(tmp_path / "mine.py"))


@pytest.mark.parametrize(("name", "labels"), [("case_study", 3), ("monte_carlo", 7)])
def test_shipped_studies_are_valid(name: str, labels: int) -> None:
    study = definition.load(name)
    assert len(study.configurations) == labels
    assert study.baseline == "baseline"


def test_the_case_study_has_a_run_with_drivers_where_its_scene_can_be_stepped() -> None:
    driven = definition.load("case_study", ["n_infrastructure=2"]).driven
    assert driven is not None
    assert (driven.configuration.label, driven.configuration.scenario) == ("driven", "driving")
    assert "n_infrastructure=2" in driven.configuration.settings
    assert definition.load("case_study", ["scene=av2:somewhere"]).driven is None


@pytest.mark.parametrize(
    ("settings", "junction"),
    [([], "scene_index=4"), (["scene_index=2"], "scene_index=2"), (["scene=intersection:3"], "scene=intersection:3")],
)
def test_the_case_study_plays_one_junction_in_all_its_runs(settings: list[str], junction: str) -> None:
    study = definition.load("case_study", settings)
    assert study.driven is not None
    played = [each.settings for each in (*study.configurations, study.driven.configuration)]
    assert all(junction in each for each in played), played
    assert all("scene_index=4" not in each for each in played) or not settings


@pytest.mark.parametrize(
    ("driven", "labels", "problem"),
    [
        ("'driving'", ("a",), r"driven: found 'driving', expected dict\(scenario=…, parameters=…, frames=…\)"),
        ("dict(parameters=dict())", ("a",), "driven: found"),
        ("dict(scenario='driving', grid=dict())", ("a",), "driven: found"),
        ("dict(scenario='driving', frames=0)", ("a",), "frames: found 0, expected a whole number from 1"),
        ("dict(scenario='driving')", ("driven",), "runs: found the label 'driven', expected another"),
    ],
)
def test_a_bad_run_with_drivers_is_refused(driven: str, labels: tuple[str, ...], problem: str, tmp_path: Path) -> None:
    runs = {label: dict(scenario="baseline") for label in labels}
    (tmp_path / "mine.py").write_text(f"def study():\n    return dict(runs={runs!r}, driven={driven})\n")
    with pytest.raises(ConfigurationError, match=problem):
        definition.load(str(tmp_path / "mine.py"))


def test_an_idle_worker_imports_no_plotting_table_or_mesh_library_and_no_kind_of_study() -> None:
    code = (
        "import sys, mast_zenoh.study.execution, mast_zenoh.study.defences\n"
        "names = ['matplotlib', 'pyarrow', 'zenoh', 'rich', 'pandas', 'scipy.stats']\n"
        "names += [f'mast_zenoh.study.defences.{kind}' for kind in ('matrix', 'drift', 'breakdown', 'cooperation')]\n"
        "print([name for name in names if name in sys.modules])"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.strip() == "[]"
