"""Partitions are visible as cut links, and two runs are played to the end of the longer."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import FRAMES, WatchedPage

from mast_zenoh.runs.events import spans
from mast_zenoh.runs.run import Run
from mast_zenoh.show.page.page import viewer_page

OpenPage = Callable[..., WatchedPage]

AGENTS = ("ego", "infra_1", "infra_2", "infra_3", "infra_4")


@pytest.fixture(scope="session")
def both(partitioned_run: Path, attacked_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a short run, in which agents are cut off, and a longer one."""
    path = tmp_path_factory.mktemp("pages") / "both.html"
    path.write_bytes(viewer_page([partitioned_run, attacked_run], 25))
    return path


def links(page: WatchedPage, frame: int) -> dict[str, str]:
    page.run("(frame) => viewer.state.seek(frame)", frame)
    return {link["agent"]: link["state"] for link in page.run("viewer.marks(0)")["links"]["links"]}


@pytest.mark.heavy
def test_a_run_without_a_command_centre_has_no_links_to_one(
    run_of_peers: Path, tmp_path: Path, open_page: OpenPage
) -> None:
    (tmp_path / "page.html").write_bytes(viewer_page([run_of_peers], 1))
    page = open_page(tmp_path / "page.html")
    assert links(page, 1) == {}
    assert "command centre" not in page.page.locator(".v-legend").inner_text()
    page.page.get_by_text("layers").click()
    assert page.page.get_by_label("sensor ranges").count() == 1
    assert page.page.get_by_label("links to the command centre").count() == 0


@pytest.mark.heavy
def test_a_partition_cuts_the_links_of_its_agents(both: Path, open_page: OpenPage) -> None:
    page = open_page(both)
    page.run("viewer.state.showPanels(1)")
    assert links(page, 10) == dict.fromkeys(AGENTS, "up")
    assert links(page, 25) == dict.fromkeys(AGENTS, "up") | {"infra_3": "cut", "infra_4": "cut"}
    assert links(page, 33) == dict.fromkeys(AGENTS, "up")
    cut = {agent["name"] for agent in page.run("viewer.marks(0).agents") if agent["cutOff"]}
    assert cut == set()
    legend = page.page.locator(".v-legend").inner_text()
    assert "by a partition" in legend
    assert "command centre" in legend

    links(page, 25)
    page.settle()
    marks = page.run("viewer.marks(0)")["links"]
    fault = page.run("viewer.palette().fault")
    for link in marks["links"]:
        ends = np.array([[marks["x"], marks["y"]], [link["x"], link["y"]]])
        middle = ends.mean(axis=0)
        assert page.coloured(fault, *middle.tolist())[1] == 0, "a link has a gap, or another colour"
    coloured = page.coloured(fault, 0, 0)[0]
    assert coloured > 20
    page.page.get_by_text("layers").click()
    page.page.get_by_label("links to the command centre").uncheck()
    page.settle()
    assert page.coloured(fault, 0, 0)[0] < coloured / 2
    page.screenshot("partition")


def test_spans_name_the_agents_whose_links_are_cut_or_impaired(loaded_run: Run) -> None:
    def affected(type_: str, backend: str, nodes: list[str]) -> dict[str, Any]:
        fault = {"label": type_, "kind": "fault", "type": type_, "at_s": 1.0, "until_s": 2.0}
        scenario = loaded_run.files.scenario | {"timeline": [fault | {"nodes": nodes, "backend": backend}]}
        run = loaded_run.with_(scenario=scenario)
        (span,) = (each for each in spans(run, np.arange(FRAMES) * 0.1) if each["kind"] == "fault")
        return {name: span[name] for name in ("cut", "impaired") if name in span}

    assert affected("Partition", "links", ["infra_1"]) == {"cut": ["infra_1"]}
    assert affected("Delay", "links", ["ego", "infra_2"]) == {"impaired": ["ego", "infra_2"]}
    assert affected("HostPartition", "network", ["infra_3", "infra_4", "link_infra_3"]) == {
        "cut": ["infra_3", "infra_4"]
    }
    assert affected("HostPartition", "network", ["command_center", "broker", "ego"]) == {"cut": list(AGENTS[1:])}
    assert affected("Kill", "process", ["infra_1"]) == {}


@pytest.mark.heavy
def test_two_runs_are_played_to_the_end_of_the_longer(both: Path, open_page: OpenPage) -> None:
    page = open_page(both)
    frames = "viewer.panels.map((panel) => panel.marks().frame)"
    assert page.run(frames) == [25, 25], "the frame to show first"
    slider = page.page.locator(".v-slider")
    assert slider.get_attribute("max") == str(FRAMES - 1)
    slider.fill(str(FRAMES - 1))
    page.settle()
    assert page.run(frames) == [35, FRAMES - 1]
    counts = page.page.locator(".v-counts")
    assert counts.nth(0).inner_text().startswith("ended at 3.6 s")
    assert "ended" not in counts.nth(1).inner_text()
    slider.fill("30")
    page.settle()
    assert page.run(frames) == [30, 30]
    assert "ended" not in counts.nth(0).inner_text()
