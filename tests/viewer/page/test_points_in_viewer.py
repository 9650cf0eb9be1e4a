"""The viewer shows some of the points of the ego's lidar where a run recorded them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from browser import WatchedPage
from page_blocks import unpack

from mast_zenoh import scenario
from mast_zenoh.arrays.geometry import to_world
from mast_zenoh.attacks.spoofers import Following
from mast_zenoh.launch import run as launcher
from mast_zenoh.runs.messages import messages
from mast_zenoh.runs.run import Run
from mast_zenoh.show.page import block
from mast_zenoh.show.page.page import viewer_page

OpenPage = Callable[..., WatchedPage]
FRAMES = 5


@pytest.fixture(scope="module")
def scanned_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run whose scans are recorded; a spoofer begins at 0.3 s."""
    path, loaded = scenario.load("spoofed", ["attack=removal", "attack_start_s=0.3", "n_infrastructure=1"])
    loaded["points"]["recorded"] = True
    resolved = scenario.resolve(path, loaded, frames=FRAMES, record=True)
    return launcher.run(resolved, tmp_path_factory.mktemp("scanned") / "run", runtime="inproc").folder


def test_points_are_some_of_those_received_in_the_world(scanned_run: Path) -> None:
    run = Run(scanned_run)
    data = block.run_block(run)
    assert data is not None
    header, columns = unpack(data)
    assert header["points"] == "ego"
    count = columns["points.count"].astype(int)
    assert len(count) == FRAMES
    assert 1500 < count.min() <= count.max() < 2000
    points = np.stack([columns[f"points.{axis}"] for axis in "xyz"], axis=1)
    sensor, scene = run.files.scene.agents[0].sensor, run.files.scene
    for frame, received in enumerate(messages(scanned_run, "agent/ego/points")):
        in_agent = to_world(received["position"].astype(float), sensor.mount_position, sensor.mount_rotation)
        place = to_world(in_agent, scene.agent_position[frame, 0], scene.agent_rotation[frame, 0])
        shown = points[count[:frame].sum() : count[: frame + 1].sum()]
        apart = np.abs(shown[:, None] - place[None, :: max(1, len(place) // 20000)]).max(axis=2).min(axis=1)
        assert np.median(apart) < 0.03


def test_the_place_of_a_spoofer_is_that_of_its_attack(scanned_run: Path) -> None:
    run = Run(scanned_run)
    data = block.run_block(run)
    assert data is not None
    header, columns = unpack(data)
    assert header["spoofers"] == ["spoofer_1"]
    places = np.stack([columns["spoofers.x"], columns["spoofers.y"]], axis=1)
    apart = np.linalg.norm(places - run.files.scene.agent_position[:FRAMES, 0, :2], axis=1)
    np.testing.assert_allclose(apart, Following().distance_m, atol=0.02)


def test_all_frames_together_are_limited(scanned_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block, "_MOST_POINTS_OF_ALL", 500)
    data = block.run_block(Run(scanned_run))
    assert data is not None
    assert unpack(data)[1]["points.count"].tolist() == [100.0] * FRAMES


def test_a_run_without_recorded_points_has_none(scanned_run: Path, tmp_path: Path) -> None:
    path, loaded = scenario.load("baseline", ["n_infrastructure=1"])
    folder = launcher.run(
        scenario.resolve(path, loaded, frames=2, record=True), tmp_path / "run", runtime="inproc"
    ).folder
    data = block.run_block(Run(folder))
    assert data is not None
    header, columns = unpack(data)
    assert header["points"] == ""
    assert header["spoofers"] == []
    assert not any(name.startswith(("points.", "spoofers.")) for name in columns)


@pytest.mark.heavy
def test_the_layer_of_points_is_drawn_from_above_and_in_the_camera(
    scanned_run: Path, tmp_path: Path, open_page: OpenPage
) -> None:
    (tmp_path / "page.html").write_bytes(viewer_page([scanned_run], 1))
    page = open_page(tmp_path / "page.html")
    assert "points of the lidar" in page.run("document.querySelector('.v-toolbar').textContent")
    pictures = "document.querySelector('canvas').toDataURL()"
    for eye in ("above", "camera"):
        page.run("(eye) => { viewer.state.showPanels(1); viewer.state.choose(0, { eye }); }", eye)
        seen = []
        for shown in (True, False):
            page.run("(points) => viewer.state.set({ layers: { ...viewer.state.layers, points } })", shown)
            page.settle()
            seen.append(page.run(pictures))
            page.screenshot(f"points_{eye}_{shown}")
        assert seen[0] != seen[1]
