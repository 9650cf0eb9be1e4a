"""Files of films and stills, read back by other programs."""

import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pypdf
import pytest
from film_samples import images, sheet_of
from PIL import Image, ImageSequence
from typer.testing import CliRunner

import mast_zenoh as mast
from mast_zenoh.cli.app import app
from mast_zenoh.errors import ExportError
from mast_zenoh.show.film import writing
from mast_zenoh.show.film.sheet import Sheet
from mast_zenoh.show.film.takes import Look

pytestmark = pytest.mark.heavy

SMALL = Look(size="480x480", dpi=60)


def test_a_gif_has_every_frame_at_its_time_with_its_pixels(attacked: mast.Run, tmp_path: Path) -> None:
    options: dict[str, Any] = {"size": "480x480", "dpi": 60, "speed": 0.7, "start": 2, "end": 15}
    out = attacked.animate(tmp_path / "film.gif", **options)
    drawn = list(images(sheet_of(attacked.path, SMALL, frames=range(2, 16)), range(2, 16)))
    with Image.open(out) as film:
        assert film.info["loop"] == 0
        shown = [
            (frame.info["duration"], np.asarray(frame.convert("RGB"), int)) for frame in ImageSequence.Iterator(film)
        ]
    assert len(shown) == 14
    assert sum(duration for duration, _ in shown) == 2000
    assert {duration for duration, _ in shown} == {140, 150}
    for (_, ours), theirs in zip(shown, drawn, strict=True):
        difference = np.abs(ours - theirs)
        assert difference.mean() < 1.0
        assert np.quantile(difference, 0.999) < 60, "only shades between colours of the key may change"
    again = attacked.animate(tmp_path / "again.gif", **options)
    assert again.read_bytes() == out.read_bytes()


@pytest.mark.parametrize("kind", ["mp4", "webm"])
def test_a_video_has_every_frame_at_the_asked_rate_with_its_pixels(
    attacked: mast.Run, tmp_path: Path, kind: str
) -> None:
    out = tmp_path / f"film.{kind}"
    assert writing.animate(attacked.path, out, SMALL, start=5, end=12, fps=20.0) == 16
    reader = imageio_ffmpeg.read_frames(str(out))
    facts = next(reader)
    assert (facts["size"], facts["fps"]) == ((480, 480), 20.0)
    shown = [np.frombuffer(frame, np.uint8).reshape(480, 480, 3).astype(int) for frame in reader]
    assert len(shown) == 16
    frames = [5 + k // 2 for k in range(16)]
    for ours, theirs in zip(shown, images(sheet_of(attacked.path, SMALL, frames=range(5, 13)), frames), strict=True):
        assert np.abs(ours - theirs).mean() < 6.0
    assert writing.animate(attacked.path, tmp_path / f"again.{kind}", SMALL, start=5, end=12, fps=20.0) == 16
    assert (tmp_path / f"again.{kind}").read_bytes() == out.read_bytes()
    ahead = next(iter(images(sheet_of(attacked.path, SMALL, frames=range(5, 13)), [12])))
    assert np.abs(shown[-1] - ahead).mean() < np.abs(shown[0] - ahead).mean()


def test_a_pdf_has_text_in_fonts_that_printers_take_and_no_date(attacked: mast.Run, tmp_path: Path) -> None:
    out = attacked.snapshot(tmp_path / "figure.pdf", 25, estimates=("local", "picture"), camera=True, size="18x14cm")
    (page,) = pypdf.PdfReader(out).pages
    assert float(page.mediabox.width) == pytest.approx(18 / 2.54 * 72, abs=1)
    text = page.extract_text()
    for words in ("uncoordinated, seen by ego", "frame 25", "the common picture", "infra_2", "missed truth", "false"):
        assert words in text
    for font in (each.get_object() for each in page["/Resources"]["/Font"].values()):
        descendants = [each.get_object() for each in font.get("/DescendantFonts", [])] or [font]
        assert {font["/Subtype"], *(each["/Subtype"] for each in descendants)} <= {
            "/Type0",
            "/CIDFontType2",
            "/TrueType",
        }
        assert all("/FontFile2" in each["/FontDescriptor"] for each in descendants), "not embedded"
    assert "/CreationDate" not in (pypdf.PdfReader(out).metadata or {})
    (plain,) = pypdf.PdfReader(attacked.snapshot(tmp_path / "column.pdf", 25, plain=True, size="8.5x8cm")).pages
    words = plain.extract_text()
    assert [part in words for part in ("false track", "the common picture", "frame 25", "RMSE")] == [True] * 2 + [
        False
    ] * 2
    again = attacked.snapshot(tmp_path / "again.pdf", 25, estimates=("local", "picture"), camera=True, size="18x14cm")
    assert again.read_bytes() == out.read_bytes()


def test_an_svg_has_text_as_text_and_a_box_for_every_outline(attacked: mast.Run, tmp_path: Path) -> None:
    out, again = (attacked.snapshot(tmp_path / name, 25) for name in ("a.svg", "b.svg"))
    assert out.read_bytes() == again.read_bytes()
    root = ET.parse(out).getroot()
    texts = ["".join(each.itertext()).strip() for each in root.iter("{http://www.w3.org/2000/svg}text")]
    assert {"the common picture", "infra_1", "false track", "t = 2.5 s   frame 25"} <= set(texts)
    assert "date" not in out.read_text().lower()
    sheet = sheet_of(attacked.path, Look(theme="light"), frames=range(25, 26))
    sheet.show(25)
    false = len(sheet.birdseye[0].outcomes["track false"].outlines.get_paths())
    red = [each for each in root.iter("{http://www.w3.org/2000/svg}path") if "stroke: #d31818" in each.get("style", "")]
    assert false > 0
    assert len(red) >= 4 * false, "an outline, a line ahead and two diagonals"


def test_the_frame_of_a_still_is_by_default_that_of_the_report(attacked: mast.Run, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["snapshot", str(attacked.path), "-o", str(tmp_path / "still.png")])
    assert result.exit_code == 0, result.output
    report = attacked.report().read_text()
    frame = int(result.output.split("frame ")[1].split(":")[0])
    assert f"(frame {frame})" in report


def test_without_its_package_ffmpeg_on_path_is_used_and_without_both_the_error_offers_a_gif(
    attacked: mast.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = imageio_ffmpeg.get_ffmpeg_exe()
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(
        ExportError, match=r"imageio-ffmpeg nor ffmpeg on PATH.*mast-zenoh\[film\].*\.gif needs neither"
    ):
        writing.animate(attacked.path, tmp_path / "film.mp4", SMALL)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "ffmpeg").symlink_to(program)
    assert writing.animate(attacked.path, tmp_path / "film.mp4", SMALL, end=3) == 4
    (tmp_path / "film.mp4").unlink()
    (tmp_path / "ffmpeg").unlink()
    (tmp_path / "ffmpeg").write_text("#!/bin/sh\necho 'Unknown encoder libx264' >&2\nexit 8\n")
    (tmp_path / "ffmpeg").chmod(0o755)
    with pytest.raises(ExportError, match=r"ffmpeg failed with exit code 8: Unknown encoder libx264"):
        writing.animate(attacked.path, tmp_path / "film.mp4", SMALL)
    assert [path.name for path in tmp_path.iterdir()] == ["ffmpeg"]


def test_nothing_is_left_behind_by_a_film_that_is_interrupted(
    attacked: mast.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(*arguments: object, **options: object) -> subprocess.Popen[bytes]:
        started.append(popen(*arguments, **options))  # type: ignore[call-overload]
        return started[-1]

    def show(sheet: Sheet, frame: int) -> None:
        if frame == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(Sheet, "show", show)
    with pytest.raises(KeyboardInterrupt):
        writing.animate(attacked.path, tmp_path / "film.mp4", SMALL)
    assert list(tmp_path.iterdir()) == []
    assert started
    assert all(process.poll() is not None for process in started), "ffmpeg is still running"
