"""A running run in a browser: what the page draws is what the run recorded, and nobody is held back."""

import os
import re
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from browser import chromium
from equal_runs import assert_equal, run_alone
from launched import MAST, Launched, eventually
from websockets.sync.client import connect

from mast_zenoh.run_folder.tables import read_table

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
_TIMEOUT_MS = 90_000
_DRAWN = """() => {
  const run = viewer.state.runs[0];
  const number = run.numberOf(viewer.state.frame);
  const boxes = ([agent, estimate]) => {
    viewer.state.choose(0, { agent, estimate });
    return viewer.marks(0).boxes.map((box) => [box.kind, box.outcome, box.id, box.x]);
  };
  const [picture, received] = [boxes(["ego", "picture"]), boxes(["infra_1", "received"])];
  return { number, picture, received, local: boxes(["ego", "local"]) };
}"""


def becomes_true(page: Any, expression: str) -> None:
    """Wait for an expression; playwright's own waiting evaluates text in the page, which its policy forbids."""
    eventually(lambda: page.evaluate(expression), expression)


def keep_screenshot(page: Any, name: str) -> None:
    """Keep a screenshot, if $MAST_TEST_SCREENSHOTS names a folder."""
    if folder := os.environ.get("MAST_TEST_SCREENSHOTS"):
        page.screenshot(path=f"{folder}/live_{name}.png")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


class LiveRun:
    """A run that a viewer shows: its output, and the page."""

    def __init__(self, run: Launched, browser: Any) -> None:
        self.run = run
        self.lines: list[str] = []
        assert run.process.stdout is not None
        self._reader = threading.Thread(target=lambda: self.lines.extend(run.process.stdout or ()))
        self._reader.start()
        self.url = str(run.until(lambda: self._found(r"view: (http\S+)"), "the viewer is ready"))
        self.page = browser.new_page(viewport={"width": 1200, "height": 900})
        self.requests: list[str] = []
        self.errors: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(self.url)
        self.page.wait_for_selector(".viewer.v-ready", timeout=_TIMEOUT_MS)

    def _found(self, pattern: str) -> str:
        match = re.search(pattern, "".join(self.lines))
        return match[1] if match else ""

    def frames(self, count: int) -> None:
        """Wait for so many frames in the page."""
        becomes_true(self.page, f"viewer.state.runs[0].frames >= {count}")

    def ended(self) -> str:
        """Wait for the end of the run; returns its output. The page has asked nobody but its server."""
        assert self.run.process.wait(150) == 0, "".join(self.lines)
        self._reader.join(10)
        assert self.errors == []
        assert set(self.requests) == {self.url}
        self.page.close()
        return "".join(self.lines)


@pytest.fixture(autouse=True)
def equal_rights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give viewers the rights of other processes: other tests may run at the same time, and would starve them."""
    monkeypatch.setenv("MAST_VIEWER_NICENESS", "0")


@pytest.fixture
def show(launch: Callable[..., Launched], browser: Any) -> Callable[..., LiveRun]:
    return lambda *words: LiveRun(launch(*words, "--view"), browser)


def recorded(folder: Path, number: int, agent: str, estimate: str) -> list[tuple[Any, ...]]:
    table = read_table(folder / "objects.parquet")
    own = (table["frame"] == number) & (table["agent"] == agent) & (table["estimator"] == estimate)
    columns = [table[name][own].tolist() for name in ("kind", "outcome", "id", "x")]
    return sorted(zip(*columns, strict=True))


def test_the_page_of_a_running_run_draws_what_is_recorded(show: Callable[..., LiveRun]) -> None:
    settings = ("--set", "attack_start_s=1.0", "--mode", "realtime", "--frames", "100")
    live = show("coordinated", *settings)
    page = live.page
    with connect(f"ws://{live.url.removeprefix('http://')}frames"):  # never reads
        live.frames(4)
        becomes_true(page, "viewer.marks(0).effects.length > 0")
        page.keyboard.press(" ")  # stays at this frame
        drawn = page.evaluate(_DRAWN)
        keep_screenshot(page, "five")
        path = page.locator(".v-wires tr", has_text="agent/infra_1/tracks").inner_text()
        assert "infra_1 → adversary_1 → broker" in path
        live.ended()
    for name, (agent, estimate) in {
        "picture": ("ego", "picture"),
        "received": ("infra_1", "received"),
        "local": ("ego", "local"),
    }.items():
        expected = recorded(live.run.out, drawn["number"], agent, estimate)
        found = sorted(map(tuple, drawn[name]))
        assert [each[:3] for each in found] == [each[:3] for each in expected]
        assert [each[3] for each in found] == pytest.approx([each[3] for each in expected], abs=0.0051)
        assert len(found) > 5


def test_a_viewer_of_a_secure_run_has_a_certificate_of_its_own_and_changes_nothing(show, launch, tmp_path) -> None:
    words = ("uncoordinated", "--set", "n_infrastructure=2", "--set", "attack_start_s=0.5", "--frames", "200")
    live = show(*words, "--secure")
    live.frames(2)
    assert live.page.evaluate("viewer.marks(0).boxes.length") > 5
    credentials = Path(live.run.record()["viewer_credentials"])
    assert credentials.name == "@viewer"
    keep_screenshot(live.page, "secure")
    live.ended()
    assert not credentials.exists(), "keys end with the run"
    alone = launch(*words, "--runtime", "inproc")
    assert alone.end()[0] == 0
    assert_equal(alone.out, live.run.out)


def test_a_killed_launcher_leaves_neither_its_viewer_nor_the_viewers_keys(launch: Callable[..., Launched]) -> None:
    words = ("--set", "n_infrastructure=1", "--mode", "realtime", "--frames", "600", "--secure", "--view")
    run = launch("baseline", *words)
    assert run.process.stdout is not None
    assert any("Ctrl-C ends the run" in line for line in run.process.stdout)
    credentials = Path(run.until(lambda: run.record().get("viewer_credentials"), "the viewer has credentials"))
    run.until(run.recorded, "frames are played")
    viewer = next(each for each in psutil.Process(run.process.pid).children() if "view" in each.cmdline())
    run.kill()
    eventually(lambda: not viewer.is_running() or viewer.status() == psutil.STATUS_ZOMBIE, "the viewer has ended")
    eventually(lambda: not credentials.parent.exists(), "the keys are deleted")


@contextmanager
def viewing(browser: Any, target: str) -> Iterator[Any]:
    """The page of `mast view TARGET`, ready, when it has shown some frames."""
    with subprocess.Popen([*MAST, "view", target], stdout=subprocess.PIPE, text=True) as viewer:
        try:
            assert viewer.stdout is not None
            page = browser.new_page()
            page.goto(viewer.stdout.readline().split()[-1])
            page.wait_for_selector(".viewer.v-ready", timeout=_TIMEOUT_MS)
            becomes_true(page, "viewer.state.runs[0].frames >= 5")
            assert page.evaluate("viewer.marks(0).boxes.length") > 3
            yield page
            page.close()
        finally:
            viewer.send_signal(signal.SIGINT)
            assert viewer.wait(20) == 0


def test_a_router_shows_its_run_without_the_run_folder(launch: Callable[..., Launched], browser: Any) -> None:
    run = launch("baseline", "--set", "n_infrastructure=1", "--mode", "realtime", "--frames", "400")
    endpoint = run.until(lambda: run.record().get("endpoint"), "the run has a router")
    run.until(run.recorded, "frames are played")
    with viewing(browser, endpoint) as page:
        run.process.send_signal(signal.SIGINT)
        assert run.end()[0] != 0
        becomes_true(page, "document.querySelector('.v-live').textContent.includes('has ended')")


def test_a_replay_is_shown_while_it_is_running(start: Callable[..., Launched], browser: Any, tmp_path: Path) -> None:
    what = ("coordinated", "n_infrastructure=2", "attack_start_s=0.5")
    recorded_run = run_alone(tmp_path / "recorded", *what, frames=30, record=True)
    replay = start(*MAST, "replay", str(recorded_run), "--loop", "--rate", "1", "--no-report", "--out")
    replay.started()
    with viewing(browser, str(replay.out)) as page:
        keep_screenshot(page, "replay")
    replay.process.send_signal(signal.SIGINT)
    replay.end()


@pytest.mark.parametrize(
    ("target", "code", "message"),
    [
        ("tcp/127.0.0.1:1", 26, "nothing answers"),
        ("udp/127.0.0.1:7447", 10, "expected the folder of a run, or a router"),
        ("nowhere", 15, "no such folder"),
    ],
)
def test_what_cannot_be_viewed_is_refused(target: str, code: int, message: str, tmp_path: Path) -> None:
    run = subprocess.run([*MAST, "view", target], capture_output=True, text=True, cwd=tmp_path, timeout=60)
    assert message in run.stderr
    assert run.returncode == code, run.stderr
