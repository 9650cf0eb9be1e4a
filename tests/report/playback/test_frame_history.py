"""The page keeps the newest frames of one running run, each once, and every event of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import resources
from typing import Any
from urllib.parse import urlsplit

import pytest

#: Makes blocks of one frame, all of whose boxes are objects, and a history of them.
_FRAMES = """
const { FrameHistory } = await import("/frame_history.js");
const whole = ["id", "kind", "truth", "known", "effect", "downlink", "by", "subscriber", "frame"];
const agents = [{ name: "ego", sectors: 8 }];
const lasting = { id: "run-1", label: "a run", agents, effects: ["inserted", "removed"] };
function block(number, { time = number / 10, boxes = 2, x = 0, spans = [], down = [], effects = [] } = {}) {
  const columns = { time: [time], matched: [], match: [], code: [] };
  const filled = (group, name, rows, value) => {
    const kind = whole.includes(name) ? Int32Array : Float64Array;
    columns[`${group}.${name}`] = kind.from({ length: rows }, (_, row) => value(row));
  };
  const box = { id: (row) => row, truth: () => 1, x: () => x };
  const geometry = ["frame", "id", "x", "y", "z", "l", "w", "h", "yaw"];
  const more = ["score", "known", "vx", "vy", "sx", "sy", "rho", "kind", "truth"];
  for (const name of [...geometry, ...more]) filled("box", name, boxes, box[name] ?? (() => 0));
  for (const name of geometry) filled("withheld", name, 0, () => 0);
  const places = ["before_x", "before_y", "before_z", "after_x", "after_y", "after_z"];
  for (const name of ["effect", "frame", "by", "subscriber", "downlink", ...places]) {
    filled("effects", name, effects.length, (row) => (name === "effect" ? effects[row] : 0));
  }
  const names = { adversaries: ["adversary_1"], subscribers: [""], views: [], meanings: [], series: [] };
  return { header: { number, spans, down, ...names }, columns };
}
const history = new FrameHistory();
history.begin(lasting);
const add = (...values) => history.add(block(...values));
const texts = () => [...history.events.values()].map((event) => `${event.time} ${event.text}`);
"""


@pytest.fixture(scope="module")
def run(browser: Any) -> Iterator[Callable[[str], Any]]:
    """Runs a script in an empty page whose site has the viewer's modules."""
    modules = resources.files("mast_zenoh.report.playback") / "page"
    page = browser.new_page()

    def answer(route: Any) -> None:
        name = urlsplit(route.request.url).path.removeprefix("/")
        if name:
            route.fulfill(body=(modules / name).read_text("utf-8"), content_type="text/javascript")
        else:
            route.fulfill(body="<!DOCTYPE html>", content_type="text/html")

    page.route("**/*", answer)
    page.goto("http://modules.test/")
    yield lambda script: page.evaluate(f"async () => {{ {_FRAMES} {script} }}")
    page.close()


def test_old_frames_are_dropped_and_counted(run: Callable[[str], Any]) -> None:
    result = run(
        """let dropped = 0;
        for (let number = 0; number < 605; number++) dropped += add(number);
        const first = history.joined();
        const large = [605, 606, 607].map((number) => add(number, { boxes: 40000 }));
        const last = history.joined();
        return [dropped, first.frames, first.numberOf(0), large, last.frames, last.numberOf(0), last.rows,
          last.absence(1.25)];"""
    )
    assert result[:6] == [5, 600, 5, [1, 1, 599], 2, 606]
    assert result[6] == 80_000
    assert result[7].startswith("The page has no frame of 1.3 s, so it shows its oldest one")


def test_frames_of_another_run_are_not_joined(run: Callable[[str], Any]) -> None:
    result = run(
        """const spans = [{ kind: "fault", begins: "Delay begins", ends: "Delay heals", from_s: 0, until_s: 9 }];
        for (const number of [7, 8, 9]) add(number, { spans, down: ["infra_1"] });
        const kept = () => [history.parts.length, history.paths.size, history.events.size, history.down.size];
        const steps = [[history.begin({ ...lasting, label: "rewired" }), ...kept()]];
        steps.push([history.begin({ ...lasting, agents: [] }), ...kept(), add(10)]);
        steps.push([history.begin({ ...lasting, id: "run-2" }), ...kept(), add(0)]);
        return [steps, history.joined().frames, history.joined().drivenPlaces];"""
    )
    same_run, other_agents, other_run = result[0]
    assert same_run == [False, 3, 2, 2, 1]
    assert other_agents == [False, 0, 2, 2, 1, 3], "what happened is kept, and the dropped frames are counted"
    assert other_run == [True, 0, 0, 0, 0, 1]
    assert result[1:] == [1, 2]


def test_a_frame_that_arrives_again_is_ignored(run: Callable[[str], Any]) -> None:
    assert run("return [add(5), add(5), add(4), add(6), history.parts.map((part) => part.header.number)]") == [
        *(0, None, None, 0),
        [5, 6],
    ]


def test_equal_events_at_other_times_are_all_listed_once(run: Callable[[str], Any]) -> None:
    result = run(
        """const fault = { kind: "fault", begins: "Delay begins", ends: "Delay heals" };
        const delay = (from_s, until_s) => ({ ...fault, from_s, until_s });
        const words = { begins: "link_1 inserted", ends: "link_1 removed" };
        const link = (from_s, until_s) => ({ kind: "interception", ...words, from_s, until_s });
        const down = ["infra_1"];
        add(1, { effects: [0, 0], down });
        add(2, { effects: [0], spans: [link(0.15, 0.2)] });
        add(3, { time: 0.333, spans: [link(0.15, 1 / 3 - 4e-4)] }); // still inserted: times are rounded
        add(7, { spans: [link(0.15, 0.35), link(0.6, 0.7), delay(0.5, 0.8)], down });
        const spans = [link(0.15, 0.35), link(0.6, 0.9), delay(0.5, 0.8), delay(1.5, 9)];
        for (const number of [20, 30]) add(number, { spans });
        return texts();"""
    )
    assert sorted(result) == [
        "0.1 adversary_1: object inserted (the first that this page has shown)",
        "0.1 infra_1 is down",
        "0.15 link_1 inserted",
        "0.2 infra_1 is back",
        "0.35 link_1 removed",
        "0.5 Delay begins",
        "0.6 link_1 inserted",
        "0.7 infra_1 is down",
        "0.8 Delay heals",
        "0.9 link_1 removed",
        "1.5 Delay begins",
        "2 infra_1 is back",
    ]


def test_places_are_as_precise_as_in_a_finished_run(run: Callable[[str], Any]) -> None:
    """Map coordinates have seven digits before the point."""
    result = run(
        """add(1, { x: 4567890.12 });
        add(2, { x: 4567890.13 });
        const joined = history.joined();
        const { "box.x": x, "box.id": id } = joined.columns;
        return [[...x], id.constructor.name, joined.before(3)];"""
    )
    assert result == [[4567890.12, 4567890.12, 4567890.13, 4567890.13], "Int32Array", 1]
