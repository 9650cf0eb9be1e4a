"""One attacked and defended run, shared by all tests of the moving picture."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import FRAME, FRAMES, WatchedPage, chromium

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.runs.run import Run
from mast_zenoh.show.html import write_report
from mast_zenoh.show.page.page import viewer_page

#: Few objects are near each other, and both liars are soon suspended.
SPARSE = "scene.dense=False"


@pytest.fixture(scope="session")
def attacked_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run with two adversaries and a command centre that judges agents."""
    soon = dict(type="SequentialConsistency", contradiction_tail=(84.0, 0.1), pair_tail=(86.0, 0.1))
    settings = ["attack_start_s=2.0", f"defence={json.dumps(soon)}", SPARSE]
    return play("defended", settings, tmp_path_factory.mktemp("runs") / "attacked")


@pytest.fixture(scope="session")
def baseline_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of the same scene without adversaries."""
    return play("baseline", [SPARSE], tmp_path_factory.mktemp("runs") / "baseline")


@pytest.fixture(scope="session")
def partitioned_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run, shorter than the others, in which two agents are cut off in its second half."""
    folder = tmp_path_factory.mktemp("runs") / "partitioned"
    return play("attack_during_partition", ["partition_s=2.0", "partition_until_s=3.0"], folder, frames=36)


@pytest.fixture(scope="session")
def run_of_peers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run without a command centre."""
    folder = tmp_path_factory.mktemp("runs") / "peers"
    return play("peers", ["n_infrastructure=2", "n_mobile=1"], folder, frames=3)


def play(name: str, settings: list[str], folder: Path, frames: int = FRAMES) -> Path:
    """Play a shipped scenario in this process."""
    path, loaded = scenario.load(name, settings)
    resolved = scenario.resolve(path, loaded, frames=frames, record=True)
    return launcher.run(resolved, folder, runtime="inproc").folder


@pytest.fixture(scope="session")
def loaded_run(attacked_run: Path) -> Run:
    return Run(attacked_run)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


@pytest.fixture(scope="session")
def report(attacked_run: Path) -> Path:
    """The report of the attacked run."""
    return write_report(attacked_run, frame=FRAME)


@pytest.fixture(scope="session")
def compared(attacked_run: Path, baseline_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with the attacked run and the same run without its adversaries."""
    path = tmp_path_factory.mktemp("pages") / "compared.html"
    path.write_bytes(viewer_page([attacked_run, baseline_run], FRAME))
    return path


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[..., WatchedPage]]:
    """Opens pages, which must contact nobody."""
    opened: list[WatchedPage] = []

    def open_(address: Path | str, **options: Any) -> WatchedPage:
        opened.append(WatchedPage(browser, address.as_uri() if isinstance(address, Path) else address, **options))
        return opened[-1]

    yield open_
    for each in opened:
        each.close()
