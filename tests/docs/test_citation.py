"""CITATION.cff is valid CFF 1.2.0 with the package's version and licence."""

from __future__ import annotations

import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))

#: Required keys of the format, and the optional ones that a package can use.
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


def test_the_citation_has_all_required_keys_and_no_unknown_ones() -> None:
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["type"] == "software"
    assert REQUIRED <= CITATION.keys() <= REQUIRED | OPTIONAL
    lists = {"authors", "keywords", "references"}
    assert all(isinstance(CITATION[name], str) and CITATION[name] for name in CITATION.keys() - lists)
    assert CITATION["authors"], "at least one"
    for author in CITATION["authors"]:
        assert "name" in author or {"family-names", "given-names"} <= author.keys(), "an entity, or a person"
    assert len(set(CITATION["keywords"])) == len(CITATION["keywords"]), "the format allows no duplicates"


def test_the_paper_is_cited_with_its_authors() -> None:
    (paper,) = CITATION["references"]
    assert {"type", "title", "authors"} <= paper.keys(), "required for every reference"
    assert all({"family-names", "given-names"} <= author.keys() for author in paper["authors"])
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(f"{author['given-names']} {author['family-names']}" in readme for author in paper["authors"])


def test_the_citation_has_the_version_and_licence_of_the_package() -> None:
    assert CITATION["version"] == PROJECT["version"]
    assert CITATION["license"] == PROJECT["license"]
    assert PROJECT["name"] in CITATION["title"]
