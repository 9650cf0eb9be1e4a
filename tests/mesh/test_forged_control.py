"""Unsigned control messages have no effect; an open mesh counts them."""

import json
import os
import signal
from pathlib import Path

import psutil
import pytest
from equal_runs import assert_equal, run_alone
from launched import Launched

from mast_zenoh.mesh.control import flow
from mast_zenoh.mesh.security.credentials import Credentials
from mast_zenoh.mesh.session import open_client
from mast_zenoh.wiring.model import Wiring

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]
WHAT = ("baseline", "--frames", "20", "--set", "n_infrastructure=1")


def credentials(record: dict) -> Credentials:
    """The stolen credentials of infra_1."""
    command = psutil.Process(record["nodes"]["infra_1"]["pid"]).cmdline()
    return Credentials.read(Path(command[command.index("--credentials") + 1]))


def test_unsigned_messages_change_nothing_and_are_counted(launch, tmp_path: Path) -> None:
    run: Launched = launch(*WHAT, "--secure", "mtls")
    record = run.started()
    thief = credentials(record)
    run.until(run.recorded, "frames are played")
    driver = record["nodes"]["simulator"]["pid"]
    os.kill(driver, signal.SIGSTOP)  # the run waits until everything is sent
    wiring = Wiring.from_json(json.loads((run.out / "wiring.json").read_text()))
    control = f"mast/{record['id']}/@control"
    with open_client(record["endpoint"], thief) as session:
        session.put(f"{control}/epoch", flow.encode_epoch(999, {"ego": "agent"}, None))
        session.put(f"{control}/stop", "end")
        session.put(f"{control}/leave/broker", "leave")
        session.put(f"{control}/act", flow.encode_act(3, [("kill", "ego")]))
        rewired = session.get(f"{control}/rewire", payload=flow.encode_rewire(wiring, {}, ["broker"]), timeout=5.0)
        drained = session.get(f"{control}/drain/ego", payload="clock", timeout=5.0)
        assert list(drained) == []
        os.kill(driver, signal.SIGCONT)
        assert list(rewired) == []
        output = run.ended()
    assert_equal(run_alone(tmp_path / "sound", "baseline", "n_infrastructure=1", frames=20, record=True), run.out)
    final_record = run.record()
    assert final_record["unsigned_control"] == 0
    assert {key: count for key, (count, _) in final_record["invalid_control"].items()} == {"act": 1}
    for name, node in final_record["nodes"].items():
        expected = {"epoch": 1, "stop": 1}
        expected |= {"broker": {"leave/broker": 1}, "ego": {"drain/ego": 1}, "simulator": {"rewire": 1}}.get(name, {})
        assert {key: count for key, (count, _) in node["invalid_control"].items()} == expected, name
        assert "found no signature" in node["invalid_control"]["stop"][1]
    assert "act: found no signature" in " ".join(output.split())
