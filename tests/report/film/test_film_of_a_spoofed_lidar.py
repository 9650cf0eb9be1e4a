"""A film shows where the spoofer of a lidar is, and how many points it inserts."""

import numpy as np
import pytest
from film_samples import sheet_of

import mast_zenoh as mast
from mast_zenoh.attacks.spoofers import Following
from mast_zenoh.run_folder.finding import sentence
from mast_zenoh.show.film.takes import Look
from mast_zenoh.show.film.writing import open_takes

FRAMES = 8


@pytest.fixture(scope="module")
def spoofed(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    """A run in which a spoofer keeps ahead of the ego, and injects 200 points from 0.3 s on."""
    out = tmp_path_factory.mktemp("spoofed") / "run"
    chosen = dict(attack_start_s=0.3, n_infrastructure=1, n_mobile=0)
    return mast.run("spoofed", frames=FRAMES, out=out, runtime="inproc", seed=1, **chosen)


def test_the_spoofer_is_marked_at_its_distance_from_the_ego(spoofed: mast.Run) -> None:
    sheet = sheet_of(spoofed.path)
    for frame in (3, FRAMES - 1):
        sheet.show(frame)
        (place,) = sheet.birdseye[0].spoofers.get_xydata()
        pose = next(row for row in spoofed.agent("ego").pose.to_pylist() if row["frame"] == frame)
        assert np.hypot(place[0] - pose["x"], place[1] - pose["y"]) == pytest.approx(Following().distance_m, abs=0.2)
    (legend,) = sheet.figure.legends
    assert "spoofer of a lidar" in [text.get_text() for text in legend.get_texts()]


def test_the_points_of_a_frame_are_counted(spoofed: mast.Run) -> None:
    (take,) = open_takes(spoofed.path, Look(), None)
    said = sentence(take.attacks.at(FRAMES - 1))
    assert "200 points inserted" in said
    assert "outside their objects" not in said
