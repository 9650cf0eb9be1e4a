"""Requirements are in pyproject.toml, and exact versions with hashes in lock files."""

from __future__ import annotations

import re
import tomllib
from itertools import chain
from pathlib import Path

import licences
import pytest
import yaml
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import mast_zenoh

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PYTHONS = ("3.11", "3.12", "3.13")
LOCKS = {
    "requirements.txt": [*PROJECT["project"]["dependencies"], *PROJECT["dependency-groups"]["build"]],
    "requirements-dev.txt": [
        *PROJECT["project"]["dependencies"],
        *PROJECT["project"]["optional-dependencies"]["dev"],
        *PROJECT["dependency-groups"]["build"],
        *PROJECT["build-system"]["requires"],
    ],
    "requirements-tools.txt": PROJECT["dependency-groups"]["tools"],
    "requirements-site.txt": PROJECT["dependency-groups"]["site"],
    "requirements-ros2.txt": PROJECT["dependency-groups"]["ros2"],
    "requirements-sumo.txt": [
        *PROJECT["project"]["dependencies"],
        *PROJECT["project"]["optional-dependencies"]["sumo"],
    ],
}

#: Their major versions follow the calendar (setuptools: every removal of a feature): a bound would only exclude fixes.
UNBOUNDED = {"cryptography", "rich", "pyarrow", "pillow", "dask", "setuptools"}


def hashes_by_entry(name: str) -> dict[str, tuple[str, frozenset[str]]]:
    """The hashes of every entry of a lock file; an entry is `name==version ; marker`."""
    lines = (ROOT / name).read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    return {
        line.partition(" --hash")[0].strip(): frozenset(re.findall(r"--hash=(\S+)", line))
        for line in lines
        if line and not line.lstrip().startswith("#")
    }


def locked(name: str) -> list[Requirement]:
    """The entries of a lock file."""
    return [Requirement(entry) for entry in hashes_by_entry(name)]


def pins(name: str, python: str) -> dict[str, str]:
    """Version by package for a Python version on Linux; fails for duplicates."""
    here = {**default_environment(), "python_version": python, "python_full_version": f"{python}.0"}
    versions: dict[str, str] = {}
    for entry in locked(name):
        if entry.marker is None or entry.marker.evaluate(here):
            package = canonicalize_name(entry.name)
            assert package not in versions, f"{package} occurs twice in {name} for Python {python}"
            (specifier,) = entry.specifier
            versions[package] = specifier.version
    return versions


@pytest.mark.parametrize("name", LOCKS)
def test_every_entry_of_a_lock_file_is_one_version_with_hashes_and_names_no_index_or_path(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    entries = [line for line in text.replace("\\\n", " ").splitlines() if line and not line.lstrip().startswith("#")]
    assert len(entries) > 20
    for entry in entries:
        assert re.match(r"[\w.-]+==[^\s*;]+ ( *;[^#]*)?( *--hash=sha256:[0-9a-f]{64} *)+$", entry + " "), entry[:200]
    for word in ("://", "--index", "--extra-index", "--find-links", "file:", " @ "):
        assert word not in text


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("name", LOCKS)
def test_the_lock_file_satisfies_all_requirements_of_pyproject(name: str, python: str) -> None:
    versions = pins(name, python)
    for text in LOCKS[name]:
        requirement = Requirement(text)
        version = versions.get(canonicalize_name(requirement.name))
        assert version is not None, f"{requirement.name} is not in {name}: run `make lock`"
        assert requirement.specifier.contains(version), (
            f"{name} has {requirement.name} {version}, expected {requirement}: run `make lock`"
        )


def test_running_and_development_use_the_same_versions_and_hashes() -> None:
    for python in PYTHONS:
        running, development = pins("requirements.txt", python), pins("requirements-dev.txt", python)
        assert running.items() <= development.items(), "run `make lock`"
        assert len(running) < len(development)
        shown = pins("requirements-site.txt", python)  # it is imported together with those of development
        assert {name: development.get(name, version) for name, version in shown.items()} == shown, "run `make lock`"
    hashes_of = {entry.partition(" ;")[0]: hashes for entry, hashes in hashes_by_entry("requirements-dev.txt").items()}
    for entry, hashes in hashes_by_entry("requirements.txt").items():
        assert hashes == hashes_of[entry.partition(" ;")[0]], entry


def test_the_lock_file_for_running_can_build_the_package_and_contains_no_development_tool() -> None:
    running = pins("requirements.txt", "3.11").keys()
    assert {Requirement(text).name for text in PROJECT["build-system"]["requires"]} <= running
    assert not running & {"pytest", "ruff", "mypy", "hypothesis", "dask", "stonesoup"}


def test_requirements_have_upper_bounds_where_a_major_version_could_break_the_package() -> None:
    extras = PROJECT["project"]["optional-dependencies"]
    texts = [*PROJECT["build-system"]["requires"], *PROJECT["project"]["dependencies"]]
    for text in (*texts, *(text for name, extra in extras.items() if name != "dev" for text in extra)):
        requirement = Requirement(text)
        if requirement.name == PROJECT["project"]["name"]:
            continue  # the packages of another extra, which is checked itself
        operators = {specifier.operator for specifier in requirement.specifier}
        assert ">=" in operators, text
        assert ("<" in operators) != (requirement.name in UNBOUNDED), text


DISTRIBUTIONS = [
    tomllib.loads(path.read_text(encoding="utf-8"))["project"]
    for path in (ROOT / "pyproject.toml", *sorted((ROOT / "plugins").glob("*/pyproject.toml")))
]


def test_the_three_distributions_have_one_version_and_license_and_accept_each_other() -> None:
    names = ["mast-zenoh", "mast-zenoh-datasets", "mast-zenoh-ros2"]
    assert [project["name"] for project in DISTRIBUTIONS] == names
    for key, value in (("version", mast_zenoh.__version__), ("license", "Apache-2.0"), ("requires-python", ">=3.11")):
        assert {project[key] for project in DISTRIBUTIONS} == {value}, key
    for project in DISTRIBUTIONS:
        texts = [*project["dependencies"], *chain.from_iterable(project.get("optional-dependencies", {}).values())]
        ours = [requirement for requirement in map(Requirement, texts) if requirement.name in names]
        assert ours, project["name"]
        for requirement in ours:
            assert requirement.specifier.contains(mast_zenoh.__version__), f"{project['name']} needs {requirement}"


def test_releases_have_wheels_for_every_python_that_the_workflow_tests() -> None:
    workflows = ROOT / ".github" / "workflows"
    tested = yaml.safe_load((workflows / "test.yml").read_text("utf-8"))["jobs"]["test"]["strategy"]["matrix"]["python"]
    built = PROJECT["tool"]["cibuildwheel"]["build"]
    assert tuple(tested) == PYTHONS
    assert built == [f"cp{python.replace('.', '')}-manylinux_*" for python in PYTHONS]
    published = yaml.safe_load((workflows / "release.yml").read_text("utf-8"))["jobs"]["publish"]["strategy"]["matrix"]
    assert published["distribution"] == [project["name"] for project in DISTRIBUTIONS]


def test_every_locked_package_has_a_licence_on_the_page_and_installed_ones_the_licence_that_they_state() -> None:
    licences_on_page = licences.written()
    assert set(licences.LOCKS) == set(LOCKS)
    assert licences_on_page.keys() == licences.locked().keys(), "run `python tools/licences.py`"
    assert licences.PAGE.read_text(encoding="utf-8") == licences.page(licences_on_page)
    stated = {name: licence for name, licence in licences.installed().items() if name in licences_on_page and licence}
    assert {"numpy", "pytest"} <= stated.keys()
    assert stated.items() <= licences_on_page.items(), "run `python tools/licences.py`"


def test_nothing_that_running_needs_is_under_the_gpl() -> None:
    running = {name for name, purpose in licences.locked().items() if purpose == "running"}
    assert not [name for name in running if "GPL" in licences.written()[name]]


def test_every_package_that_running_needs_has_a_reason_in_contributing() -> None:
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## What running needs")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ([\w, -]+) \| [\d.]+ \| \w.* \|$", section, flags=re.MULTILINE)
    explained = sorted(name for row in rows for name in row.split(", "))
    assert explained == sorted({canonicalize_name(entry.name) for entry in locked("requirements.txt")})
