"""A node may take as long to finish as it makes progress; one that hangs is ended."""

from pathlib import Path

import numpy as np
import pytest

from mast_zenoh import scenario
from mast_zenoh.errors import NodeDied
from mast_zenoh.launch import launcher_protocol, run
from mast_zenoh.mesh.control.results import PART_ROWS
from mast_zenoh.run_folder import read_json
from mast_zenoh.run_folder.tables import read_table

GRACE_S = 1.5  #: of these runs, in place of 20 s

SCENARIO = """
from mast_zenoh.config import loading

_, baseline = loading.function("scenarios", "baseline", "scenario")


def scenario(end="compute"):
    return baseline(n_infrastructure=1) | dict(
        name="slow",
        nodes=dict(slow=dict(role="visualizer", file="slow.py", end=end, on_exit="fail")),
        keyexpr=dict(rewrites=[{"listen": [dict(wire="clock", role="visualizer", input="clock")]}]),
    )
"""

NODE = f"""
import gc
import threading
import time

import numpy as np

from mast_zenoh.node import Node


class Slow(Node):
    role = "visualizer"
    inputs = {{"clock": "clock"}}

    def __init__(self, end: str):
        self.end = end

    def on_clock(self, received, context):
        assert gc.isenabled(), "it is off only until the node is hosted"
        context.append("rows", self.rows(received.frame * 30_000, 30_000))

    def rows(self, start, count):
        row = np.arange(start, start + count)
        return {{"row": row, "name": np.array(["even", "odd"], object)[row % 2]}}

    def finish(self, context):
        if self.end == "hang":
            threading.Event().wait()
        if self.end == "compute":
            while time.process_time() < {2 * GRACE_S}:
                sum(range(1000))
        return {{"end": self.end, "tables": {{"rows": self.rows(150_000, 7)}}}}
"""


def played(folder: Path, runtime: str, end: str) -> run.EndedRun:
    """A run of five frames with a node that ends so."""
    (folder / "slow.py").write_text(NODE)
    (folder / "scene.py").write_text(SCENARIO)
    path, content = scenario.load(str(folder / "scene.py"), [f"end={end}"])
    return run.run(scenario.resolve(path, content, frames=5, record=True), folder / runtime, runtime=runtime)


@pytest.mark.heavy
def test_a_node_that_computes_for_longer_than_the_limit_ends_well_and_its_tables_are_those_of_one_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launcher_protocol, "LEAVE_GRACE_S", GRACE_S)
    for runtime in ("mesh", "inproc"):
        ended = played(tmp_path, runtime, "compute" if runtime == "mesh" else "at once")
        assert ended.error is None, ended.error
        assert read_json(ended.folder / "results/slow/results.json")["end"] in ("compute", "at once")
    files = [tmp_path / runtime / "results/slow/rows.parquet" for runtime in ("mesh", "inproc")]
    assert read_table(files[0])["row"].tolist() == [*range(150_007)]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_node_that_hangs_at_its_end_is_ended_after_the_limit_and_its_tables_up_to_then_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launcher_protocol, "LEAVE_GRACE_S", GRACE_S)
    ended = played(tmp_path, "mesh", "hang")
    assert isinstance(ended.error, NodeDied)
    assert str(ended.error).startswith("slow has not")
    assert (ended.folder / "metrics.json").is_file(), "the others have handed in theirs"
    rows = read_table(ended.folder / "results/slow/rows.parquet")["row"]
    np.testing.assert_array_equal(rows, np.arange(2 * PART_ROWS))
