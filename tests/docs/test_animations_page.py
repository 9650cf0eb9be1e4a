"""The page on films and figures works as written."""

from __future__ import annotations

from pathlib import Path

import imageio_ffmpeg
import pytest
from page_commands import play_page
from PIL import Image

pytestmark = pytest.mark.heavy

PAGE = (Path(__file__).parents[2] / "docs" / "animations.md").read_text(encoding="utf-8")


@pytest.mark.timeout(300)
def test_every_command_of_the_page_works_as_written(tmp_path: Path) -> None:
    folder = play_page(PAGE, tmp_path, least=5)
    for name, count in (("film.gif", 60), ("slow.gif", 21), ("both.gif", 16)):
        with Image.open(folder / name) as film:
            assert film.n_frames == count
    for name, count in (("film.mp4", 16), ("compared.webm", 26)):
        assert imageio_ffmpeg.count_frames_and_secs(str(folder / name))[0] == count
    assert (folder / "figure.pdf").read_bytes().startswith(b"%PDF")
    assert (folder / "ego.pdf").read_bytes().startswith(b"%PDF")
    assert "<svg" in (folder / "figure.svg").read_text()
    assert (folder / "figure.png").stat().st_size > 10_000
    printed = (folder / "printed").read_text()
    assert "film: film.mp4 (16 images" in printed
    assert "frame 45: figure.svg" in printed
