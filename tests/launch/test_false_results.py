"""False results of one node affect only that node, not the run."""

import functools
import json
import time
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
from insider.forgeries import false_results, forgeries, refused
from insider.position import MARKER, Position, position
from rich.console import Console

from mast_zenoh import run_folder, scenario, version
from mast_zenoh.cli.options import reporting
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import MastError
from mast_zenoh.launch import ending
from mast_zenoh.launch.context import Mesh, RunContext
from mast_zenoh.launch.mesh_run import MeshLauncher
from mast_zenoh.launch.supervisor import Child, Supervisor
from mast_zenoh.mesh.control import results
from mast_zenoh.show import html, terminal

pytestmark = pytest.mark.heavy

NODES = ("infra_1", "broker", "adversary_1", "coordinator", "link_ego", "evaluator", "recorder")


class Ended(Child):
    """A process that has exited successfully."""

    exit = 0

    def where(self) -> dict[str, Any]:
        return {"pid": 1}


@functools.cache
def resolved() -> Resolved:
    path, loaded = scenario.load("rogue")
    return scenario.resolve(path, loaded | {"run": {"record": True}}, frames=3, mode="lockstep", record=True)


def at(node: str) -> Position:
    return position(resolved(), node, version.version_string())


def concluded(node: str, payload: bytes, out: Path, secure: str = "open") -> dict[str, Any]:
    """run.json of a run in which only one node returns results."""
    folder = run_folder.create(out, "false")
    resolved().write(folder)
    record: dict[str, Any] = {"id": "x", "message": "", "timings": {}, "churn": [], "nodes": {}}
    context = RunContext(resolved(), lambda line: None, time.monotonic, folder=folder, record=record, secure=secure)
    supervisor = MagicMock(children={name: Ended(name, spec) for name, spec in resolved().nodes.items()})
    supervisor.to_json = functools.partial(Supervisor.to_json, supervisor)
    launcher = MeshLauncher(context, Mesh(MagicMock(), supervisor), MagicMock())
    query = MagicMock(to_bytes=lambda: payload)
    launcher._reports._on_result(MagicMock(key_expr=f"mast/x/@control/result/{node}", payload=query))
    try:
        launcher._protocol.finish()
        launcher.conclude(time.monotonic())
    except MastError as error:
        record["message"] = str(error)
    if error := ending.of_run(None, record, str(folder)):
        assert "recorder" in str(error)
    run_folder.write_json(folder / "run.json", record)
    return record


def test_above_level_open_reports_of_obeyed_unsigned_messages_are_ignored(tmp_path: Path) -> None:
    (claim,) = (outcome for outcome in false_results(at("infra_1")) if outcome["unsigned"] > 10**6)
    claimed, secured = (concluded("infra_1", results.pack(claim), tmp_path / at, at) for at in ("open", "acl"))
    assert claimed["unsigned_control"] == claimed["nodes"]["infra_1"]["unsigned_control"] == claim["unsigned"]
    assert secured["unsigned_control"] == secured["nodes"]["infra_1"]["unsigned_control"] == 0


@pytest.mark.parametrize("node", NODES)
def test_the_launcher_concludes_a_run_whatever_results_one_node_returns(tmp_path: Path, node: str) -> None:
    payloads = [results.pack(outcome) for outcome in false_results(at(node))]
    payloads += [forgery.payload for forgery in forgeries("result", at(node), 90) if forgery.sender == node]
    taken = [payload for payload in payloads if not refused("result", node, payload)]
    assert len(taken) > 60
    for number, payload in enumerate(taken):
        folder = tmp_path / str(number)
        concluded(node, payload, folder)
        json.loads((folder / "run.json").read_text())
        strays = [path for path in tmp_path.rglob(f"*{MARKER}*") if path.parent != folder / "results" / node]
        assert strays == []
        top = {path.name for path in folder.glob("*.parquet")}
        assert not top or node == "evaluator"
        for path in (*folder.rglob("*.parquet"), *folder.rglob("results.json")):
            path.unlink()


def test_a_report_is_written_for_any_evaluator_results_and_explains_odd_ones(tmp_path: Path) -> None:
    written, explained, console = 0, 0, Console(file=StringIO())
    for number, outcome in enumerate(false_results(at("evaluator"))):
        payload = results.pack(outcome)
        if outcome["results"].keys() & {"metrics", "tables"} and not refused("result", "evaluator", payload):
            folder = tmp_path / str(number)
            concluded("evaluator", payload, folder)
            with reporting(folder):
                terminal.show_run(console, folder)
                html.write_report(folder)
            written += 1
            explained += "No scores: metrics.json is damaged" in (folder / "report.html").read_text()
    assert written > 10
    assert explained, "metrics in another format"
