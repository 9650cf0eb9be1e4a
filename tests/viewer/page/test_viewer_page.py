"""The viewer in a browser: what it draws is what was recorded, and all its controls work."""

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import FRAME, FRAMES, WatchedPage

from mast_zenoh.run_folder.tables import read_table

pytestmark = pytest.mark.heavy

OpenPage = Callable[..., WatchedPage]

_AT = """([index, mark]) => {
  const panel = viewer.panels[index];
  const box = panel.canvas.getBoundingClientRect();
  const [x, y] = viewer.viewport.toScreen(mark.x, mark.y, box.width, box.height);
  return [box.left + x, box.top + y];
}"""


def table_marks(folder: Path, frame: int, agent: str, estimate: str) -> list[tuple[Any, ...]]:
    """What objects.parquet says about a view in a frame, sorted."""
    table = read_table(folder / "objects.parquet")
    own = (table["frame"] == frame) & (table["agent"] == agent) & (table["estimator"] == estimate)
    names = ("kind", "outcome", "id", "x", "y", "yaw", "cause", "by")
    return sorted(zip(*(table[name][own].tolist() for name in names), strict=True))


def drawn_marks(page: WatchedPage, frame: int, agent: str, estimate: str) -> dict[str, Any]:
    page.run(
        "([frame, agent, estimate]) => { viewer.state.seek(frame); viewer.state.choose(0, { agent, estimate }); }",
        [frame, agent, estimate],
    )
    marks: dict[str, Any] = page.run("viewer.marks(0)")
    assert (marks["frame"], marks["agent"], marks["estimate"]) == (frame, agent, estimate)
    return marks


def test_the_drawn_marks_are_those_of_the_recording(report: Path, attacked_run: Path, open_page: OpenPage) -> None:
    page = open_page(report)
    attacks = read_table(attacked_run / "attacks.parquet")
    compared = false = 0
    for frame in (0, 22, FRAME, FRAMES - 1):
        for agent, estimate in (("ego", "picture"), ("ego", "mission"), ("infra_1", "local"), ("infra_2", "received")):
            marks = drawn_marks(page, frame, agent, estimate)
            expected = table_marks(attacked_run, frame, agent, estimate)
            drawn = sorted(
                tuple(box[name] for name in ("kind", "outcome", "id", "x", "y", "yaw", "cause", "by"))
                for box in marks["boxes"]
            )
            assert [each[:3] + each[6:] for each in drawn] == [each[:3] + each[6:] for each in expected]
            assert np.allclose([each[3:6] for each in drawn], [each[3:6] for each in expected], atol=0.0051)
            compared += len(drawn)
            false += sum(each[1] == "false" for each in drawn)
            here = attacks["frame"] == frame
            changed = sorted(zip(attacks["effect"][here].tolist(), attacks["interposer"][here].tolist(), strict=True))
            found = sorted((each["effect"], each["by"]) for each in marks["effects"])
            assert found == ([] if estimate == "local" else changed)
    assert compared > 300
    assert false > 0, "an attack without false tracks tests little"


def test_the_truth_shows_all_objects_of_the_scene(report: Path, loaded_run: Any, open_page: OpenPage) -> None:
    marks = drawn_marks(open_page(report), FRAME, "ego", "truth")
    truth = loaded_run.files.scene.truth_at(FRAME)
    assert sorted(box["id"] for box in marks["boxes"]) == sorted(truth.id.tolist())
    speeds = {box["id"]: math.hypot(box["vx"], box["vy"]) for box in marks["boxes"]}
    for identity, velocity in zip(truth.id.tolist(), truth.velocity, strict=True):
        assert speeds[identity] == pytest.approx(math.hypot(*velocity[:2]), abs=0.05)


def test_agents_are_marked_with_their_adversaries_and_states(
    report: Path, attacked_run: Path, open_page: OpenPage
) -> None:
    marks = drawn_marks(open_page(report), FRAMES - 1, "ego", "picture")
    trust = read_table(attacked_run / "trust.parquet")
    last = trust["frame"] == FRAMES - 1
    states = dict(zip(trust["agent"][last].tolist(), trust["state"][last].tolist(), strict=True))
    assert {agent["name"]: agent["state"] for agent in marks["agents"]} == states
    assert "suspended" in states.values()
    compromised = {agent["name"] for agent in marks["agents"] if agent["adversaries"]}
    assert compromised == {agent["name"] for agent in marks["agents"] if agent["lying"]} == {"infra_1", "infra_2"}


def test_slider_keys_and_playing_move_through_the_run(report: Path, open_page: OpenPage) -> None:
    page = open_page(report)
    frame = "viewer.state.frame"
    assert page.run(frame) == FRAME
    page.page.locator(".v-slider").fill("10")
    page.settle()
    assert page.run(frame) == 10
    assert "frame 10 of 55" in page.page.locator(".v-now").inner_text()
    page.page.locator(".v-canvas").first.focus()
    page.page.keyboard.press("ArrowRight")
    page.page.keyboard.press("Shift+ArrowRight")
    assert page.run(frame) == 21
    page.page.keyboard.press("End")
    assert page.run(frame) == FRAMES - 1
    page.page.keyboard.press("Home")
    page.page.get_by_label("speed").select_option("4")
    page.page.get_by_role("button", name="play").click()
    page.page.get_by_text(f"frame {FRAMES - 1} of").wait_for(timeout=60_000)
    page.page.get_by_role("button", name="play").wait_for()
    assert not page.run("viewer.state.playing")


def test_the_canvas_shows_false_tracks_red_and_matched_ones_blue(report: Path, open_page: OpenPage) -> None:
    page = open_page(report)
    false, matched = next(
        pair
        for frame in range(22, FRAMES)
        for tracks in [[box for box in drawn_marks(page, frame, "ego", "mission")["boxes"] if box["kind"] == "track"]]
        for pair in itertools.product(tracks, tracks)
        if [box["outcome"] for box in pair] == ["false", "matched"] and 8 < math.dist(*map(_place, pair)) < 30
    )
    page.run("([x, y]) => Object.assign(viewer.viewport, { x, y, half: 40 })", _place(false))
    colours = [page.run(f"viewer.palette().outcomes['{name}']") for name in ("track false", "track matched")]
    layers = ["trails", "velocity", "ellipses", "links", "ranges", "space", "manipulations", "paths"]
    page.run(f"viewer.state.set({{ layers: Object.fromEntries({layers}.map((name) => [name, false])) }})")
    near = []
    for estimate in ("mission", "truth"):
        page.run("(estimate) => viewer.state.choose(0, { estimate })", estimate)
        page.settle()
        near += [[page.coloured(each, *_place(box), 40, 6)[1] > 3 for each in colours] for box in (false, matched)]
    assert near == [[True, False], [False, True], [False, False], [False, False]]
    page.screenshot("pixels")


def _place(box: dict[str, Any]) -> tuple[float, float]:
    return box["x"], box["y"]


def test_hovering_says_what_a_box_is_and_why(report: Path, open_page: OpenPage) -> None:
    page = open_page(report)
    marks: dict[str, Any] = {}
    for frame in range(22, FRAMES):
        marks = drawn_marks(page, frame, "ego", "picture")
        false = [box for box in marks["boxes"] if box["outcome"] == "false" and box["cause"] == "inserted"]
        if false:
            break
    page.run("(box) => { viewer.viewport.x = box.x; viewer.viewport.y = box.y; viewer.zoom(2); }", false[0])
    page.settle()
    page.page.locator(".v-canvas").first.scroll_into_view_if_needed()
    page.page.mouse.move(*page.run(_AT, [0, false[0]]))
    page.settle()
    tip = page.page.locator(".v-tip").first
    tip.wait_for(state="visible")
    text = tip.inner_text()
    assert f"false track · id {false[0]['id']}" in text
    assert f"score {false[0]['score']:.2f}" in text
    assert "speed" in text
    assert f"cause: follows an object inserted by {false[0]['by'].replace('+', ', ')}" in text
    page.screenshot("hover")


def test_an_event_leads_to_its_frame(report: Path, open_page: OpenPage) -> None:
    page = open_page(report)
    first = page.page.locator(".v-event", has_text="adversary_1 inserts its first object")
    first.click()
    page.settle()
    frame = page.run("viewer.state.frame")
    assert any(each["effect"] == "inserted" for each in page.run("viewer.marks(0)")["effects"])
    assert frame == page.run("viewer.state.runs[0].events.find((e) => e.text.startsWith('adversary_1 inserts')).frame")
    assert page.run("document.querySelector('.v-event.v-effect').closest('li').classList.contains('v-past')")


def test_three_estimates_stand_side_by_side(report: Path, open_page: OpenPage) -> None:
    page = open_page(report, width=1900, height=1080)
    page.page.get_by_role("button", name="three panels side by side").click()
    page.settle()
    boxes = [each.bounding_box() for each in page.page.locator(".v-canvas").all()]
    assert len(boxes) == 3
    assert len({box["y"] for box in boxes}) == 1
    assert boxes[0]["x"] + boxes[0]["width"] <= boxes[1]["x"] < boxes[2]["x"]
    page.page.locator(".v-panel").nth(2).get_by_label("agent").select_option("infra_3")
    shown = page.run("viewer.panels.map((panel) => panel.marks()).map((m) => [m.agent, m.estimate])")
    assert shown == [["ego", "mission"], ["ego", "picture"], ["infra_3", "local"]]
    page.screenshot("side_by_side")


def test_two_runs_are_compared_by_swiping(compared: Path, open_page: OpenPage) -> None:
    page = open_page(compared, theme="dark")
    names = page.run("viewer.panels.map((panel) => panel.run.header.name)")
    assert names == ["defended", "baseline"]
    page.page.get_by_role("button", name="swipe").click()
    page.settle()
    first, second = (each.bounding_box() for each in page.page.locator(".v-canvas").all())
    assert first == second
    divider = page.page.get_by_role("separator").bounding_box()
    y = divider["y"] + divider["height"] / 2
    page.page.mouse.move(divider["x"] + 11, y)
    page.page.mouse.down()
    page.page.mouse.move(first["x"] + first["width"] * 0.25, y, steps=4)
    page.page.mouse.up()
    page.settle()
    assert page.run("viewer.state.share") == pytest.approx(0.25, abs=0.02)
    clip = page.run("getComputedStyle(document.querySelectorAll('.v-stage')[1]).clipPath")
    assert clip.startswith("inset(0px 0px 0px 2")
    assert page.run("viewer.marks(0).effects.length") > 0
    assert page.run("viewer.marks(1).effects.length") == 0
    page.screenshot("swipe")


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_at_500_px_nothing_is_cut_off(report: Path, open_page: OpenPage, theme: str) -> None:
    page = open_page(report, width=500, height=900, theme=theme)
    assert page.run("document.documentElement.scrollWidth") == 500
    beyond = """() => [...document.querySelectorAll(".viewer *")].filter((each) => {
      const box = each.getBoundingClientRect();
      return box.width > 0 && (box.right > 500 || box.left < 0);
    }).map((each) => each.className)"""
    assert page.run(beyond) == []
    canvas = page.page.locator(".v-canvas").bounding_box()
    assert canvas["width"] > 400
    page.screenshot(f"500_{theme}")


def test_printing_gives_the_chosen_frame_without_controls(report: Path, open_page: OpenPage) -> None:
    page = open_page(report, theme="dark")
    page.page.locator(".v-slider").fill("30")
    page.page.emulate_media(media="print")
    page.settle()
    assert not page.page.locator(".v-toolbar").is_visible()
    assert not page.page.locator(".v-slider").is_visible()
    assert "frame 30 of" in page.page.locator(".v-now").inner_text()
    corner = page.run(
        "[...document.querySelector('.v-charts').getContext('2d').getImageData(2, 2, 1, 1).data].slice(0, 3)"
    )
    assert min(corner) > 240, "on paper the charts are light, also if the screen is dark"
    ink = page.run("getComputedStyle(document.querySelector('.v-legend')).color")
    assert ink == "rgb(27, 31, 36)"
    assert page.run("viewer.palette().outcomes['truth matched']") in page.page.locator(".v-legend").inner_html()
    assert page.page.pdf()[:5] == b"%PDF-"


def test_palettes_differ_and_the_legend_follows(report: Path, open_page: OpenPage) -> None:
    page = open_page(report)
    missed = "viewer.palette().outcomes['truth missed']"
    before = page.run(missed), page.page.locator(".v-legend").inner_html()
    page.page.get_by_label("colours").select_option("safe")
    page.settle()
    assert page.run(missed) != before[0]
    assert page.run(missed) in page.page.locator(".v-legend").inner_html()
    assert before[0] not in page.page.locator(".v-legend").inner_html()


def test_without_scripts_the_report_still_shows_its_figures(report: Path, browser: Any) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(report.as_uri())
    assert page.locator("details.static img").is_visible()
    assert "needs JavaScript" in page.locator(".viewer").inner_text()
    context.close()
