"""Report pages are complete, self-contained, correctly escaped and accurate."""

import base64
import hashlib
import html
import re
from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote

import pytest
from page_blocks import unpack
from parsed_page import Page
from run_samples import edit
from table_writing import write_table

from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.runs.run import Run
from mast_zenoh.show.html import write_report, write_study_report

RunFolderFixture = Callable[..., Path]


@pytest.fixture
def study(three_runs: dict[str, Path], tmp_path: Path, unpainted: None) -> Page:
    return Page(write_study_report(tmp_path, three_runs))


def assert_only_the_viewer_is_a_script(page: Page) -> None:
    """The page's policy admits one script, by its hash, and the network not at all."""
    scripts = re.findall(r'<script type="module">(.*?)</script>', page.source, re.DOTALL)
    assert len(scripts) == ("Content-Security-Policy" in page.source)
    assert len(re.findall("<script", page.source)) == len(scripts) + page.source.count(
        '<script type="application/x-mast-run"'
    )
    for each in scripts:
        digest = base64.b64encode(hashlib.sha256(each.encode()).digest()).decode()
        assert f"'none'; script-src 'sha256-{digest}'" in html.unescape(page.source)


def assert_self_contained(page: Page, folder: Path) -> None:
    for link in page.links:
        assert link.startswith(("data:image/", "#")) or (folder / unquote(link)).is_file(), link[:80]
        assert not link.startswith("#") or link[1:] in page.ids
    assert not {"link", "iframe", "object", "base"} & set(page.tags)
    assert_only_the_viewer_is_a_script(page)
    assert "url(" not in page.source
    assert "@import" not in page.source


def test_run_report_is_self_contained_and_its_figures_are_saved(run_folder: RunFolderFixture) -> None:
    folder = run_folder("uncoordinated")
    page = Page(write_report(folder))
    assert_self_contained(page, folder)
    assert all(link.startswith(("data:", "#")) for link in page.links)
    saved = {path.stem: path.read_bytes() for path in (folder / "figures").glob("*.png")}
    assert set(saved) == {"birdseye", "camera", "counts", "wiring"}
    for name, data in saved.items():
        assert data.startswith(b"\x89PNG")
        assert len(data) > 5000
        assert data in page.embedded or (folder / "figures" / f"{name}.svg").read_bytes() in page.embedded
    assert len(page.images) == len(saved)
    assert all(len(image["alt"] or "") > 30 for image in page.images)
    headings = re.findall(r'<h2 id="([\w-]+)">', page.source)
    assert {"frames", "scores", "wiring", "reproduce"} <= set(headings)
    assert [link[1:] for link in page.links if link.startswith("#")] == headings


@pytest.mark.usefixtures("without_figures")
def test_a_run_whose_numbers_cannot_be_packed_has_a_report_without_the_viewer(run_folder: RunFolderFixture) -> None:
    folder = run_folder("uncoordinated")
    table = read_table(folder / "objects.parquet")
    table["x"] = table["x"] + 1e9
    write_table(folder / "objects.parquet", table)
    page = Page(write_report(folder))
    assert "left out: box.x" in page.text
    assert page.ids.count("frames") == 0
    assert_only_the_viewer_is_a_script(page)


@pytest.mark.usefixtures("unpainted")
def test_names_are_escaped_in_html(run_folder: RunFolderFixture) -> None:
    evil = '<script>alert("x")</script>'
    node = {"role": evil, "pid": 1, "exit": 1, "ended": evil, "restarts": 0}
    ends = {"publisher": evil, "subscribers": [evil, "$x^{"], "interposers": [evil]}
    wire = {"key": evil, "message": evil} | ends
    folder = run_folder(
        "uncoordinated",
        run={"id": evil, "status": evil, "message": evil, "command": [evil], "nodes": {evil: node, "$x^{": node}},
        scenario={evil: evil},
        wiring={evil: evil, "wires": lambda wires: [*wires, wire]},
    )
    page = Page(write_report(folder))
    assert_self_contained(page, folder)
    assert "<script>alert" not in page.source
    assert evil in page.text


MISSING = {
    "run.json": set(),
    "wiring.json": {"wiring"},
    "metrics.parquet": {"birdseye", "camera", "counts"},
    "objects.parquet": {"birdseye", "camera"},
    "scene.npz": {"camera"},
}


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize("name", sorted(MISSING))
def test_a_truncated_or_missing_file_is_named_and_everything_else_is_shown(
    run_folder: RunFolderFixture, name: str
) -> None:
    folder = run_folder("uncoordinated")
    (folder / name).write_bytes((folder / name).read_bytes()[:-20])
    (problem,) = Run(folder).files.missing
    assert problem.startswith(f"{name} cannot be")
    (folder / name).unlink()
    assert f"{name} is absent" in Page(write_report(folder)).text
    drawn = {path.stem for path in (folder / "figures").glob("*.png")}
    assert drawn == {"birdseye", "camera", "counts", "wiring"} - MISSING[name]


def test_an_interrupted_run_still_has_a_report(run_folder: RunFolderFixture) -> None:
    folder = run_folder("uncoordinated")
    for path in [*folder.glob("*.parquet"), *folder.glob("*.npz")]:
        path.unlink()
    interrupted = {"status": "interrupted", "message": "stopped by Ctrl-C in frame 12"}
    edit(folder, run=interrupted, metrics=..., wiring=...)
    page = Page(write_report(folder))
    assert "frame 12" in page.text
    assert "No scores" in page.text
    assert page.images == []


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match=r"neither run\.json.*scenario\.json"):
        write_report(tmp_path)
    with pytest.raises(RunFolderError, match="no such folder"):
        write_report(tmp_path / "nothing")


@pytest.mark.usefixtures("unpainted")
def test_only_an_existing_frame_can_be_requested(run_folder: RunFolderFixture) -> None:
    folder = run_folder("uncoordinated")
    assert "t = 0.7 s (frame 7)" in (Page(write_report(folder, frame=7)).images[0]["alt"] or "")
    with pytest.raises(RunFolderError, match=r"frame 40.*0"):
        write_report(folder, frame=40)


def test_a_study_report_compares_its_runs_in_one_frame(study: Page, tmp_path: Path) -> None:
    assert_self_contained(study, tmp_path)
    blocks = re.findall(r"data-run>(.*?)</script>", study.source)
    labels = [unpack(base64.b64decode(block))[0]["label"] for block in blocks]
    assert labels == ["baseline", "uncoordinated", "coordinated"], "the viewer has all runs on one timeline"
    assert "more false objects" in study.text
    assert "common picture misses" in study.text
    assert {path.name for path in (tmp_path / "figures").glob("*.png")} == {
        "side_by_side.png",
        "counts.png",
    }
    frames = {image["alt"].partition("(frame ")[2][:3] for image in study.images if "(frame " in (image["alt"] or "")}
    assert len(frames) == 1
    assert "uncoordinated: 2 missed" in (study.images[0]["alt"] or "")
    for name in ("baseline", "uncoordinated", "coordinated"):
        assert (tmp_path / name / "report.html").is_file()
        assert f"{name}/report.html" in study.links
        assert "../report.html" in Page(tmp_path / name / "report.html").links


@pytest.mark.usefixtures("unpainted")
def test_a_study_report_names_what_its_runs_lack(run_folder: RunFolderFixture, tmp_path: Path) -> None:
    runs = {"baseline": run_folder(), "uncoordinated": run_folder("uncoordinated")}
    for path in [*runs["uncoordinated"].glob("*.parquet"), runs["uncoordinated"] / "metrics.json"]:
        path.unlink()
    assert "metrics.json is absent" in Page(write_study_report(tmp_path, runs)).text
    for path in runs["baseline"].iterdir():
        if path.is_file() and path.name != "run.json":
            path.unlink()
    twice = dict.fromkeys(("only", "twice"), runs["baseline"])
    assert "2 runs compared" in Page(write_study_report(tmp_path / "study folder", twice)).text
