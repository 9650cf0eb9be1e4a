"""Pages and texts of a run without a centre do not speak of one."""

import re
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from commands_in_process import command
from rich.console import Console

import mast_zenoh as mast
from mast_zenoh.report.film.takes import Take
from mast_zenoh.report.terminal import show_run
from mast_zenoh.runs.events import spans
from mast_zenoh.runs.run import Run

SETTINGS = dict(n_infrastructure=3, n_mobile=1, n_adversaries=1, attack_start_s=0.3, defence="Pasac")
FRAMES = 12


@pytest.fixture(scope="module")
def run_of_peers(tmp_path_factory: pytest.TempPathFactory) -> mast.Run:
    out = tmp_path_factory.mktemp("peers") / "run"
    return mast.run("peers", frames=FRAMES, seed=3, **SETTINGS, out=out)


def text_of(page: Path) -> str:
    """What a reader of a page sees, without scripts and markup."""
    text = re.sub(r"<(script|style).*?</\1>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", text).split())


def test_the_report_and_the_terminal_speak_of_the_ego_and_its_peer(run_of_peers: mast.Run) -> None:
    ended = command("report", run_of_peers.path)
    assert ended.code == 0, ended.err
    page = text_of(run_of_peers.path / "report.html")
    console = Console(file=StringIO(), width=1000)
    show_run(console, run_of_peers.path)
    terminal = console.file.getvalue()
    for text in (page, terminal, run_of_peers.headline):
        assert "common picture" not in text
        assert "command centre" not in text
    assert "picture of the ego" in page
    assert "the ego peer" in page
    assert "the ego peer suspended" in terminal


def test_titles_of_films_and_events_of_the_viewer_do_too(run_of_peers: mast.Run) -> None:
    run = Run(run_of_peers.path)
    assert not run.has_centre
    assert Take(run, "picture").title == "the picture of the ego"
    begins = [span["begins"] for span in spans(run, np.arange(FRAMES) * run.period_s) if span["kind"] == "suspension"]
    assert begins
    assert all(each.startswith("the ego peer suspends ") for each in begins)
