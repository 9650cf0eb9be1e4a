"""The page of a running run follows it over lost connections, to its end, and while it is paused."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from launched import eventually
from recorded_observer import RecordedObserver

from mast_zenoh.runs.live.reception import LegState, WireState
from mast_zenoh.show.page.live_server import Feed, LiveBlocks, LiveServer

pytestmark = pytest.mark.heavy

Frames = list[tuple[dict[str, Any], bytes]]

_NUMBERS = range(20, 26)
_WIRE = WireState("agent/ego/tracks", (LegState("ego", "agent", "agent/ego/tracks", 10.0, 1, 0.0),), ("broker",))


@pytest.fixture(scope="module")
def frames(attacked_run: Path) -> Frames:
    """Some frames of the attacked run, as its viewer would have sent them."""
    observer: Any = RecordedObserver(attacked_run, _NUMBERS, [_WIRE])
    blocks = LiveBlocks(observer)
    return [blocks.header_and_block(frame) for frame in observer.waiting if frame is not None]


class LivePage:
    """A page, and the server that it was opened from."""

    def __init__(self, browser: Any, frames: Frames) -> None:
        self.frames = frames
        self.server = LiveServer("a run", Feed()).__enter__()
        self.page = browser.new_page(viewport={"width": 1200, "height": 900})
        self.errors: list[str] = []
        self.sockets: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("websocket", lambda socket: self.sockets.append(socket.url))
        self.page.goto(self.server.url)

    def run(self, expression: str) -> Any:
        return self.page.evaluate(expression)

    def becomes(self, expression: str, value: Any) -> None:
        eventually(lambda: self.run(expression) == value, f"{expression} is {value}", 60)

    def publish(self, index: int, **lasting: Any) -> None:
        """Publish a frame, and wait until it is shown. lasting: changes of its header"""
        header, block = self.frames[index]
        self.server.feed.publish(header | lasting, block)
        self.becomes("window.viewer ? viewer.state.runs[0].live.number : -1", _NUMBERS[index])

    def restart(self, title: str) -> Feed:
        """End the server without a word, and start another one at its port."""
        port, feed = self.server.port, Feed()
        self.server.__exit__(None, None, None)
        self.server = LiveServer(title, feed, port).__enter__()
        return feed

    def numbers(self) -> list[int]:
        numbers: list[int] = self.run("viewer.state.runs[0].parts.map((part) => part.header.number)")
        return numbers

    def close(self) -> None:
        self.page.close()
        self.server.__exit__(None, None, None)
        assert self.errors == []


@pytest.fixture
def open_live(browser: Any, frames: Frames) -> Iterator[Callable[[], LivePage]]:
    opened: list[LivePage] = []

    def open_() -> LivePage:
        opened.append(LivePage(browser, frames))
        return opened[-1]

    yield open_
    for each in opened:
        each.close()


def test_after_a_lost_connection_the_page_goes_on_with_its_run_and_opens_another_one(
    open_live: Callable[[], LivePage],
) -> None:
    live = open_live()
    for index in (0, 1, 2):
        live.publish(index)
    feed = live.restart("a run")
    feed.publish(*live.frames[2])
    eventually(lambda: feed.is_wanted, "the page connects again, and gets the newest frame")
    live.publish(3)
    assert live.numbers() == [20, 21, 22, 23], "the newest frame was sent again"

    header, block = live.frames[0]
    live.restart("another run").publish(header | {"id": "run-2"}, block)
    live.page.locator("h1", has_text="another run").wait_for()
    live.page.locator(".viewer.v-ready").wait_for()
    assert live.run("viewer.state.runs[0].header.id") == "run-2"
    assert live.numbers() == [20]


def test_a_run_that_ends_is_not_taken_for_a_lost_connection_and_notes_need_no_frame(
    open_live: Callable[[], LivePage],
) -> None:
    live = open_live()
    status = "document.querySelector('.v-live').textContent"
    live.server.feed.note(["frame 3 cannot be shown"])
    live.becomes(status, "Waiting for the next frame of the run. · frame 3 cannot be shown")
    live.publish(0)
    live.run(
        """() => {
          window.said = [];
          const status = document.querySelector(".v-live");
          new MutationObserver(() => said.push(status.textContent)).observe(status, { childList: true });
        }"""
    )
    for header, block in live.frames[1:4]:
        live.server.feed.publish(header, block)
    live.server.feed.close(reload=False)
    live.becomes(status, "The run has ended.")
    assert [text for text in live.run("said") if "connection" in text] == []
    assert len(live.sockets) == 1
    assert live.numbers() == [20, 21, 22, 23]

    table = live.page.locator(".v-wires")
    assert table.get_attribute("open") is None, "no node sits inside a wire"
    live.page.locator(".v-wires summary").click()
    live.page.locator(".v-wires td", has_text="agent/ego/tracks").wait_for()


def test_a_paused_page_says_when_its_frame_is_gone_and_follows_the_run_again(
    open_live: Callable[[], LivePage],
) -> None:
    live = open_live()
    for index in (0, 1, 2):
        live.publish(index)
    assert live.page.get_by_label("speed").count() == 0, "a running run has its own speed"
    live.page.keyboard.press("ArrowLeft")
    assert live.run("[viewer.state.frame, viewer.state.playing]") == [1, False]
    live.publish(3)
    notice = live.page.locator(".v-notice")
    assert live.run("viewer.state.frame") == 1
    assert notice.is_hidden()

    agents = [agent | {"sectors": 0} for agent in live.frames[4][0]["agents"]]
    live.publish(4, agents=agents)  # all frames are dropped
    notice.wait_for()
    assert notice.inner_text().startswith("The page has no frame of 2.1 s, so it shows its oldest one")
    assert live.run("viewer.marks(0).boxes.length") > 3
    if folder := os.environ.get("MAST_TEST_SCREENSHOTS"):
        live.page.screenshot(path=f"{folder}/live_gone.png")

    live.page.keyboard.press("End")
    notice.wait_for(state="hidden")
    live.publish(5, agents=agents)
    assert live.run("[viewer.state.frame, viewer.state.playing]") == [1, True]
    live.page.locator(".v-event").first.click()
    notice.wait_for()
