"""A compromised node under `--secure` sends arbitrary control messages."""

from __future__ import annotations

import json
from pathlib import Path

import compromised
import pytest
from launched_apart import Beside

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ImplausibleCounts
from mast_zenoh.launch import run as launcher
from mast_zenoh.messagelog.difference import compare

pytestmark = pytest.mark.mesh


def small(frames: int = 5) -> Resolved:
    path, loaded = scenario.load("baseline", ["n_infrastructure=2"])
    return scenario.resolve(path, loaded, frames=frames, record=True)


def compromised_engine(node: str, call: str) -> Beside:
    folder = str(Path(compromised.__file__).parent)
    return Beside({node: f"__import__('sys').path.append({folder!r}); __import__('compromised').{call}"})


def test_forged_messages_of_a_node_change_nothing_and_are_reported(tmp_path: Path) -> None:
    resolved = small()
    sound = launcher.run(resolved, tmp_path / "sound", runtime="inproc")
    outcome = launcher.run(
        resolved, tmp_path / "run", engine=compromised_engine("infra_1", "send_invalid_messages()"), secure="acl"
    )
    assert outcome.error is None
    assert compare(sound.folder, outcome.folder, taps=True).first is None
    metrics = [json.loads((run.folder / "metrics.json").read_text()) for run in (sound, outcome)]
    assert metrics[0] == metrics[1]
    written = {path.relative_to(outcome.folder).as_posix() for path in outcome.folder.rglob("*.parquet")}
    assert written == {path.relative_to(sound.folder).as_posix() for path in sound.folder.rglob("*.parquet")}
    assert {path.name for path in tmp_path.iterdir()} == {"sound", "run"}
    assert not Path("/tmp/mast_escaped.parquet").exists()
    record = json.loads((outcome.folder / "run.json").read_text())
    refused = {key: count for key, (count, _) in record["invalid_control"].items()}
    assert refused == {"result/infra_1": 10, "fetch/infra_1": 10, "file/infra_1": 10, "failed/infra_1": 7}
    assert record["nodes"]["simulator"]["invalid_control"]["counts/infra_1"][0] == len(compromised.RUBBISH)
    (notice,) = (notice for notice in record["notices"] if notice["kind"] == "control")
    assert notice["text"].startswith("37 invalid control messages refused on 4 keys (most: fetch/infra_1, 10,")
    assert "nodes report 7 invalid control messages on 1 key (most: counts/infra_1, 7 by simulator," in notice["text"]


def test_a_node_that_reports_more_messages_than_it_received_ends_the_run_by_name(tmp_path: Path) -> None:
    outcome = launcher.run(
        small(), tmp_path / "run", engine=compromised_engine("infra_1", "overreport('clock')"), secure="acl"
    )
    assert isinstance(outcome.error, ImplausibleCounts)
    assert str(outcome.error).startswith("infra_1 reports 1000000000 messages of simulator handled on clock, of which ")
    record = json.loads((outcome.folder / "run.json").read_text())
    assert record["status"] == "failed"
    assert "infra_1 reports 1000000000" in record["message"]
