"""Every picture of the documentation is shown, described, and can be made again."""

from __future__ import annotations

import re
from pathlib import Path

import pictures
import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
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
    assert files == {pictures.FOLDER / name for name in pictures.RECIPES}, "a picture without a recipe, or the reverse"
    for path, places in shown.items():
        for page, description in places:
            assert len(description) > 30, f"{page}: {path.name} needs a description for those who cannot see it"


def test_the_film_of_an_interception_is_small_and_readable() -> None:
    path = pictures.FOLDER / "interception.gif"
    assert path.stat().st_size < 3e6
    with Image.open(path) as film:
        assert film.width == 800
        assert 60 <= film.n_frames <= 150
        assert film.info["loop"] == 0


def test_an_unknown_picture_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert pictures.main(["interception.png"]) == 2
    assert "no recipe for 'interception.png'; did you mean 'interception.gif'?" in capsys.readouterr().err
