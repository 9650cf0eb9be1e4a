"""CITATION.cff is a citation in the Citation File Format 1.2.0, of the version and under the licence of the package."""

from __future__ import annotations

import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))

#: Of the format's keys, those that it requires, and those of its optional ones that a package can fill in.
REQUIRED = {"cff-version", "message", "title", "authors"}
OPTIONAL = {
    "type",
    "abstract",
    "version",
    "license",
    "keywords",
    "date-released",
    "repository-code",
    "url",
    "references",
}


def test_the_citation_has_what_the_format_requires_and_nothing_that_it_does_not_know() -> None:
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["type"] == "software"
    assert REQUIRED <= CITATION.keys() <= REQUIRED | OPTIONAL
    lists = {"authors", "keywords", "references"}
    assert all(isinstance(CITATION[name], str) and CITATION[name] for name in CITATION.keys() - lists)
    assert CITATION["authors"], "at least one"
    for author in CITATION["authors"]:
        assert "name" in author or {"family-names", "given-names"} <= author.keys(), "an entity, or a person"
    assert len(set(CITATION["keywords"])) == len(CITATION["keywords"]), "the format allows none twice"


def test_the_paper_is_cited_with_its_authors() -> None:
    (paper,) = CITATION["references"]
    assert {"type", "title", "authors"} <= paper.keys(), "required of every reference"
    assert all({"family-names", "given-names"} <= author.keys() for author in paper["authors"])
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(f"{author['given-names']} {author['family-names']}" in readme for author in paper["authors"])


def test_what_is_cited_has_the_version_and_the_licence_of_the_package() -> None:
    assert CITATION["version"] == PROJECT["version"]
    assert CITATION["license"] == PROJECT["license"]
    assert PROJECT["name"] in CITATION["title"]
