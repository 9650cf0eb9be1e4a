"""What a page and a terminal say of runs, word by word."""

import io
from collections.abc import Callable
from pathlib import Path

import pytest
from kept_texts import assert_kept, visible
from parsed_page import Page
from rich.console import Console
from run_samples import edit
from table_writing import write_table
from test_report_achievement import ACHIEVED, DRIVES, NOT_HIDDEN, targets
from test_report_confidence import confident
from test_report_fault_tables import ATTACK, CHECKS, KILL, PARTITION, faulted
from test_report_trust import doubted, judged

from mast_zenoh.show.html import write_report
from mast_zenoh.show.terminal import show_run

pytestmark = pytest.mark.usefixtures("unpainted")

KILLED = {"role": "agent", "pid": 77, "exit": -9, "ended": "killed by signal 9", "restarts": 2}
KILLED |= {"last_frame": 21, "rejected": {"agent/infra_2/pose: truncated": 3}, "foreign": {}, "failures": []}
FAILED = KILLED | {"exit": 0, "ended": "ok", "restarts": 0, "rejected": {}}
FAILED |= {"failures": [{"handler": "on_pose", "count": 1, "exception": "ValueError: no", "where": "agent.py:7"}]}


def test_the_words_on_a_run_in_which_everything_happened(run_folder: Callable[..., Path]) -> None:
    folder = doubted(judged(faulted(run_folder("uncoordinated"), PARTITION, KILL, ATTACK, checks=CHECKS)))
    edit(folder, **confident())
    nodes = {"infra_2": lambda _: KILLED, "infra_3": lambda _: FAILED}
    edit(folder, run={"nodes": nodes, "runtime": "mesh", "security": "open", "unsigned_control": 25})
    achieved = {"adversary_1": NOT_HIDDEN, "adversary_2": ACHIEVED, "all": ACHIEVED}
    overlapping = DRIVES["mission"] | {"overlapping_objects": 0.75}
    edit(folder, metrics={"achieved": achieved, "driving": {"ego": DRIVES | {"mission": overlapping}}})
    write_table(folder / "targets.parquet", targets("removed", seen_by_others=True))
    page, terminal = write_report(folder), Console(file=io.StringIO(), width=120)
    show_run(terminal, folder)
    assert_kept("page_of_a_run", visible(page))
    assert_kept("terminal_of_a_run", terminal.file.getvalue())
    drawn = {path.stem for path in (folder / "figures").glob("*.png")}
    assert drawn == {"birdseye", "camera", "counts", "wiring", "trust", "causes"}
    kinds = [kind for kind, _ in Page(page).rows]
    assert (kinds.count("bad"), kinds.count("hostile")) == (3, 4)


def test_the_words_on_two_runs(run_folder: Callable[..., Path]) -> None:
    assert_kept("page_of_two_runs", visible(write_report(run_folder("uncoordinated"), against=run_folder())))
