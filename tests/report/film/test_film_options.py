"""Invalid options name what was found, where, and what was expected; nothing is written."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError, ExportError, MastError, RunFolderError
from mast_zenoh.launch import liveness
from mast_zenoh.show.film.look import Look
from mast_zenoh.show.film.writing import open_takes, schedule

INVALID: list[tuple[str, dict[str, Any], type[MastError], str]] = [
    ("film.avi", {}, ExportError, r"film\.avi: expected a name that ends with \.mp4, \.gif or \.webm"),
    ("film", {}, ExportError, r"expected a name that ends with"),
    ("nowhere/film.gif", {}, ExportError, r"found no folder '.*nowhere', expected it to exist"),
    ("f.gif", {"agent": "infra1"}, ConfigurationError, r"no agent 'infra1' in this run; did you mean 'infra_1'"),
    ("f.gif", {"estimates": "pictures"}, ConfigurationError, r"unknown estimate 'pictures': .*did you mean 'picture'"),
    ("f.gif", {"estimates": ["picture"] * 3}, ConfigurationError, r"found 3 panels, .*or two: mast view shows three"),
    ("f.gif", {"estimates": []}, ConfigurationError, r"found 0 panels"),
    ("f.gif", {"theme": "blue"}, ConfigurationError, r"unknown theme 'blue': expected one of dark, light"),
    ("f.gif", {"window": "near"}, ConfigurationError, r"window: found 'near', expected fit, follow,"),
    ("f.gif", {"window": "1,2"}, ConfigurationError, r"window: found '1,2'"),
    ("f.gif", {"window": "0,nan,9"}, ConfigurationError, r"window: found '0,nan,9'"),
    ("f.gif", {"window": "follow:-3"}, ConfigurationError, r"window: found 'follow:-3'"),
    ("f.gif", {"size": "big"}, ConfigurationError, r"size: found 'big', expected WIDTHxHEIGHT, such as"),
    ("f.gif", {"size": "9x9"}, ConfigurationError, r"size: found '9x9', .*expected 240 to 8192 px"),
    ("f.gif", {"size": "300x300"}, ConfigurationError, r"leaves no room for 1 panel: expected a larger size"),
    ("f.gif", {"dpi": 7}, ConfigurationError, r"dpi: found 7, expected 20 to 1200"),
    ("f.gif", {"captions": ["here"]}, ConfigurationError, r"caption: found 'here', expected FRAME:TEXT"),
    ("f.gif", {"colour": 1}, ConfigurationError, r"no option 'colour'"),
    ("f.gif", {"start": 30}, RunFolderError, r"found frame 30, expected one of 0 to 29"),
    ("f.gif", {"end": -1}, RunFolderError, r"found frame -1, expected one of 0 to 29"),
    ("f.gif", {"start": 9, "end": 8}, ConfigurationError, r"found 9 to 8, expected the first not to be after"),
    ("f.gif", {"speed": 0}, ConfigurationError, r"speed: found 0, expected 0\.01 to 100"),
    ("f.gif", {"fps": float("nan")}, ConfigurationError, r"fps: found nan"),
    ("f.gif", {"fps": 60}, ConfigurationError, r"fps: found 60, expected at most 50 in a GIF"),
]


@pytest.mark.parametrize(("name", "options", "error", "words"), INVALID)
def test_an_invalid_option_is_refused_and_leaves_nothing(
    attacked: mast.Run, tmp_path: Path, name: str, options: dict[str, Any], error: type[MastError], words: str
) -> None:
    with pytest.raises(error, match=words) as caught:
        attacked.animate(tmp_path / name, **options)
    assert type(caught.value) is error
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_exists_is_kept(attacked: mast.Run, tmp_path: Path) -> None:
    (tmp_path / "film.gif").write_text("mine")
    (tmp_path / "still.pdf").symlink_to(tmp_path / "nothing")
    with pytest.raises(ExportError, match=r"film\.gif: exists already: expected a new file"):
        attacked.animate(tmp_path / "film.gif")
    with pytest.raises(ExportError, match=r"still\.pdf: exists already"):
        attacked.snapshot(tmp_path / "still.pdf")
    assert (tmp_path / "film.gif").read_text() == "mine"
    with pytest.raises(ExportError, match=r"expected a name that ends with \.pdf, \.svg or \.png"):
        attacked.snapshot(tmp_path / "still.gif", 4)
    with pytest.raises(ConfigurationError, match=r"found 2 estimates of two runs, expected one"):
        attacked.animate(tmp_path / "new.gif", against=attacked, estimates=("local", "picture"))


def test_runs_without_boxes_or_in_progress_are_refused_with_what_to_do(edited: Path, tmp_path: Path) -> None:
    (edited / "objects.parquet").unlink()
    with pytest.raises(RunFolderError, match=r"nothing to draw: objects\.parquet is absent.*`mast report .*` measures"):
        mast.open(edited).animate(tmp_path / "film.gif")
    record = json.loads((edited / "run.json").read_text())
    (edited / "run.json").write_text(json.dumps(record | {"status": "running", "launcher": liveness.identity()}))
    with pytest.raises(RunFolderError, match=r"the run is still in progress: expected a finished run"):
        mast.open(edited).animate(tmp_path / "film.gif")


def test_damaged_tables_are_refused_or_left_out(edited: Path, tmp_path: Path) -> None:
    (edited / "attacks.parquet").write_bytes(b"PAR1")
    (edited / "scene.npz").write_bytes(b"PK")
    assert mast.open(edited).snapshot(tmp_path / "still.svg", 12).is_file(), "boxes are enough for a still"
    with pytest.raises(RunFolderError, match=r"ego has no camera"):
        mast.open(edited).snapshot(tmp_path / "camera.svg", 12, camera=True)
    (edited / "objects.parquet").write_bytes(b"PAR1")
    with pytest.raises(RunFolderError, match=r"nothing to draw: .*objects\.parquet cannot be read"):
        mast.open(edited).snapshot(tmp_path / "other.svg", 12)


@pytest.mark.parametrize(
    ("speed", "fps", "frames", "rate"),
    [
        (1.0, None, [0, 1, 2, 3, 4, 5], 10.0),
        (0.5, None, [0, 1, 2, 3, 4, 5], 5.0),
        (1.0, 20.0, [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5], 20.0),
        (2.0, 10.0, [0, 2, 4], 10.0),
        (6.0, None, [0, 2, 4], 30.0),
        (100.0, None, [0], 30.0),
    ],
)
def test_a_film_is_as_fast_as_asked(
    attacked: mast.Run, speed: float, fps: float | None, frames: list[int], rate: float
) -> None:
    (take,) = open_takes(attacked.path, Look())
    plan = schedule(take, 0, 5, speed, fps)
    assert (list(plan.frames), plan.fps) == (frames, pytest.approx(rate))


def test_sizes_have_units_and_are_even() -> None:
    assert Look(size="1281x721").pixels(1) == (1280, 720)
    assert Look(size="10x5cm", dpi=254).pixels(1) == (1000, 500)
    assert Look(size="7.5x4in", dpi=200).pixels(2) == (1500, 800)


@pytest.mark.parametrize(
    ("nodes", "shown"),
    [
        ({}, "picture"),
        ({"driver_ego": {"config": {"agent": "ego"}}}, "mission"),
        ({"driver_ego": {"config": {"agent": "ego", "estimate": "safety"}}}, "local"),
        ({"driver_ego": {"config": {"agent": "ego", "estimate": "truth"}}}, "picture"),
    ],
)
def test_a_film_shows_what_the_driver_of_the_agent_believes(
    attacked: mast.Run, tmp_path: Path, nodes: dict[str, Any], shown: str
) -> None:
    run = tmp_path / "run"
    shutil.copytree(attacked.path, run)
    scenario = json.loads((run / "scenario.json").read_text())
    (run / "scenario.json").write_text(json.dumps(scenario | {"nodes": scenario["nodes"] | nodes}))
    assert [take.estimate for take in open_takes(run, Look())] == [shown]
