"""What the documentation says is what the code does."""

from pathlib import Path

import generate_docs
import pytest

from mast_zenoh import errors

DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.parametrize("name", sorted(generate_docs.PAGES))
def test_a_generated_page_is_up_to_date(name: str) -> None:
    assert (DOCS / name).read_text(encoding="utf-8") == generate_docs.PAGES[name](), "run `make docs`"


def test_every_error_has_an_exit_code_of_its_own() -> None:
    codes = {error.__name__: error.exit_code for error in generate_docs.error_types()}
    assert len(set(codes.values())) == len(codes), codes
    assert 2 not in codes.values(), "2 is a usage error on the command line"


def test_the_error_tree_is_printed_in_its_module() -> None:
    for error in generate_docs.error_types():
        assert f"{error.__name__} " in (errors.__doc__ or ""), error
        assert f" {error.exit_code} " in (errors.__doc__ or ""), error


def test_every_page_that_a_page_links_to_is_there() -> None:
    import re

    for page in (*DOCS.glob("*.md"), DOCS.parent / "README.md", DOCS.parent / "CONTRIBUTING.md"):
        for target in re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
