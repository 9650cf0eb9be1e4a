"""Invalid options name what was found, where, and what was expected; nothing is written."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import mast_zenoh as mast
from mast_zenoh.errors import ConfigurationError, ExportError, MastError, RunFolderError
from mast_zenoh.launch import liveness
from mast_zenoh.show.film.takes import Look
from mast_zenoh.show.film.writing import open_takes, schedule

INVALID: list[tuple[str, dict[str, Any], type[MastError], str]] = [
    ("film.avi", {}, ExportError, r"film\.avi.*name.*\.mp4"),
    ("film", {}, ExportError, r"name.*ends"),
    ("nowhere/film.gif", {}, ExportError, r"no folder '.*nowhere'"),
    ("f.gif", {"agent": "infra1"}, ConfigurationError, r"agent 'infra1'.*'infra_1'"),
    ("f.gif", {"estimates": "pictures"}, ConfigurationError, r"estimate 'pictures'.*'picture'"),
    ("f.gif", {"estimates": ["picture"] * 3}, ConfigurationError, r"3 panels.*two"),
    ("f.gif", {"estimates": []}, ConfigurationError, r"found 0 panels"),
    ("f.gif", {"theme": "blue"}, ConfigurationError, "unknown theme 'blue'"),
    ("f.gif", {"window": "near"}, ConfigurationError, r"window.*'near'.*follow"),
    ("f.gif", {"window": "1,2"}, ConfigurationError, r"window: found '1,2'"),
    ("f.gif", {"window": "0,nan,9"}, ConfigurationError, r"window: found '0,nan,9'"),
    ("f.gif", {"window": "follow:-3"}, ConfigurationError, r"window: found 'follow:-3'"),
    ("f.gif", {"size": "big"}, ConfigurationError, r"size.*'big'.*WIDTHxHEIGHT"),
    ("f.gif", {"size": "9x9"}, ConfigurationError, r"size.*'9x9'.*px"),
    ("f.gif", {"size": "300x300"}, ConfigurationError, r"leaves.*panel.*larger"),
    ("f.gif", {"dpi": 7}, ConfigurationError, r"dpi.*7.*20"),
    ("f.gif", {"captions": ["here"]}, ConfigurationError, r"caption.*'here'.*FRAME:TEXT"),
    ("f.gif", {"colour": 1}, ConfigurationError, r"no option 'colour'"),
    ("f.gif", {"start": 30}, RunFolderError, r"frame 30.*0"),
    ("f.gif", {"end": -1}, RunFolderError, r"frame -1.*0"),
    ("f.gif", {"start": 9, "end": 8}, ConfigurationError, r"9.*first.*after"),
    ("f.gif", {"speed": 0}, ConfigurationError, r"speed.*0.*0\.01"),
    ("f.gif", {"fps": float("nan")}, ConfigurationError, r"fps: found nan"),
    ("f.gif", {"fps": 60}, ConfigurationError, r"fps.*60.*GIF"),
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
    with pytest.raises(ExportError, match=r"film\.gif: exists already"):
        attacked.animate(tmp_path / "film.gif")
    with pytest.raises(ExportError, match=r"still\.pdf: exists already"):
        attacked.snapshot(tmp_path / "still.pdf")
    assert (tmp_path / "film.gif").read_text() == "mine"
    with pytest.raises(ExportError, match=r"name.*ends.*\.pdf"):
        attacked.snapshot(tmp_path / "still.gif", 4)
    with pytest.raises(ConfigurationError, match=r"2 estimates.*runs"):
        attacked.animate(tmp_path / "new.gif", against=attacked, estimates=("local", "picture"))


def test_runs_without_boxes_or_in_progress_are_refused_with_what_to_do(edited: Path, tmp_path: Path) -> None:
    (edited / "objects.parquet").unlink()
    with pytest.raises(RunFolderError, match=r"draw: objects\.parquet.*measures"):
        mast.open(edited).animate(tmp_path / "film.gif")
    record = json.loads((edited / "run.json").read_text())
    (edited / "run.json").write_text(json.dumps(record | {"status": "running", "launcher": liveness.identity()}))
    with pytest.raises(RunFolderError, match=r"still.*progress.*finished"):
        mast.open(edited).animate(tmp_path / "film.gif")


def test_damaged_tables_are_refused_or_left_out(edited: Path, tmp_path: Path) -> None:
    (edited / "attacks.parquet").write_bytes(b"PAR1")
    (edited / "scene.npz").write_bytes(b"PK")
    assert mast.open(edited).snapshot(tmp_path / "still.svg", 12).is_file(), "boxes are enough for a still"
    with pytest.raises(RunFolderError, match=r"ego.*no camera"):
        mast.open(edited).snapshot(tmp_path / "camera.svg", 12, camera=True)
    (edited / "objects.parquet").write_bytes(b"PAR1")
    with pytest.raises(RunFolderError, match=r"nothing to draw: .*objects\.parquet"):
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
