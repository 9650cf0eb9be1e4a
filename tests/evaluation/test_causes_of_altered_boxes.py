"""What changes no place of an object is no cause of missed objects and false tracks."""

from __future__ import annotations

from pathlib import Path

import pytest
from played import play

FRAMES = 80
FILE = str(Path(__file__).with_name("altered_boxes.py"))


@pytest.mark.parametrize("setting", ["length=2.0", "turn_rad=0.5"])
def test_a_false_box_is_blamed_for_no_error_of_place_which_are_those_of_the_twin(tmp_path: Path, setting: str) -> None:
    apart = "scene.dense=False"  # in queues, boxes that nearly touch are grouped otherwise if one is longer
    run = play(tmp_path / "run", FILE, apart, setting, frames=FRAMES)
    twin = play(tmp_path / "twin", FILE, apart, frames=FRAMES)
    assert (run.table("attacks")["effect"] == "altered").sum() > FRAMES
    assert not (twin.table("attacks")["effect"] == "altered").any()
    for errors in ("fn", "fp"):
        assert (run.table("metrics")[errors] == twin.table("metrics")[errors]).all(), "no error of place is new"
    assert not (run.table("objects")["cause"] == "altered").any()


def test_false_velocities_are_blamed_for_nothing_in_the_tracks_that_carry_them(tmp_path: Path) -> None:
    objects = play(tmp_path / "run", FILE, "velocity=2.0", frames=FRAMES).table("objects")
    blamed = objects["cause"] == "altered"
    assert not (blamed & (objects["estimator"] == "received")).any()
