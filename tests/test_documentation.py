"""The documentation agrees with the code."""

import ast
import re
from pathlib import Path

import generate_docs
import pytest
from reference.exit_codes import error_types

from mast_zenoh import errors

DOCS = Path(__file__).parents[1] / "docs"
PACKAGE = DOCS.parent / "mast_zenoh"


@pytest.mark.parametrize("name", sorted(generate_docs.PAGES))
def test_a_generated_page_is_up_to_date(name: str) -> None:
    assert (DOCS / name).read_text(encoding="utf-8") == generate_docs.PAGES[name](), "run `make docs`"


def test_every_error_has_its_own_exit_code() -> None:
    codes = {error.__name__: error.exit_code for error in error_types()}
    assert len(set(codes.values())) == len(codes), codes
    assert 2 not in codes.values(), "2 is a usage error on the command line"


def test_the_error_tree_is_printed_in_its_module() -> None:
    for error in error_types():
        assert f"{error.__name__} " in (errors.__doc__ or ""), error
        assert f" {error.exit_code} " in (errors.__doc__ or ""), error


def pages_of_docs() -> list[Path]:
    """The pages that are kept, not those that the site is made with."""
    return [*DOCS.glob("*.md"), *DOCS.glob("results/*.md")]


def test_linked_pages_exist() -> None:
    for page in (
        *DOCS.glob("*.md"),
        *DOCS.glob("results/*.md"),
        DOCS.parent / "README.md",
        DOCS.parent / "CONTRIBUTING.md",
    ):
        for target in re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_linked_headings_exist() -> None:
    pages = (*pages_of_docs(), *DOCS.parent.glob("*.md"))
    headings = {page.resolve(): headings_of(page.read_text(encoding="utf-8")) for page in pages}
    for page in pages:
        for file, anchor in re.findall(r"\]\(([^)#:\s]*)#([^)\s]+)\)", page.read_text(encoding="utf-8")):
            target = (page.parent / file).resolve() if file else page.resolve()
            assert anchor in headings[target], f"{page.name} links to {file}#{anchor}"


def headings_of(text: str) -> set[str]:
    """The anchors of a page's headings, as made by GitHub."""
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    titles = re.findall(r"^#+ (.*)$", prose, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_contributing_names_only_tests_that_exist() -> None:
    named = re.findall(r"`(tests/[\w/.]+)`", (DOCS.parent / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    assert named
    assert [name for name in named if not (DOCS.parent / name).exists()] == []


#: A line of a list of modules: names, two spaces, and what they are for.
LISTED = re.compile(r"^ *(\w+/?(?:, \w+/?)*)  +\S", re.MULTILINE)
#: Suffixes of modules.
MODULES = (".py", ".pyx")


def test_lists_of_modules_in_docstrings_of_packages_name_only_what_exists() -> None:
    for file in PACKAGE.rglob("__init__.py"):
        text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        listed = {name.strip("/") for names in LISTED.findall(text) for name in names.split(", ")}
        assert listed <= {path.stem for path in file.parent.iterdir() if path.is_dir() or path.suffix in MODULES}, file


def test_lists_of_modules_of_viewers_are_complete() -> None:
    for folder in (PACKAGE / name for name in ("show/page", "runs", "runs/live", "show/film")):
        words = re.findall(r"\w+", ast.get_docstring(ast.parse((folder / "__init__.py").read_text("utf-8"))) or "")
        modules = {path.stem for path in folder.glob("*.py")} - {"__init__"}
        assert modules <= set(words), folder
