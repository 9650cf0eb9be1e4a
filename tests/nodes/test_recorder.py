"""The recorder records all messages without influencing the run."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from tiny_world import Run

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, DiskFull
from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.run_folder.recording.reader import read

SETTINGS = ("n_infrastructure=2", "n_adversaries=1", "attack_start_s=0.2")


def resolved(record: bool = True, **run: Any) -> Resolved:
    path, content = scenario.load("coordinated", SETTINGS)
    content["scene"] = dict(type="TinyScene", n_infrastructure=2)
    content["run"] |= run
    return scenario.resolve(path, content, frames=8, record=record)


def recorded(folder: Path, *, encode: bool) -> dict[str, list[bytes]]:
    """The recorded bytes by key."""
    process = InProcess(resolved().in_folder(folder), encode=encode)
    outcome = process.run()
    by_key: dict[str, list[bytes]] = defaultdict(list)
    for message in read(folder / "messages.mcap"):
        by_key[message.key].append(message.payload)
    assert outcome["recorder"]["recorded"] == {"messages": sum(map(len, by_key.values())), "malformed": 0, "lost": 0}
    return by_key


@pytest.mark.parametrize("encode", [True, False], ids=["bytes are passed", "messages are passed"])
def test_a_recording_has_every_byte_sent_on_every_key(tmp_path: Path, encode: bool) -> None:
    run = Run(resolved(record=False))
    recorded_bytes = recorded(tmp_path, encode=encode)
    assert any("@tap" in key for key in recorded_bytes)
    assert recorded_bytes == {key: payloads for key, payloads in run.messages.items() if payloads}


def test_a_recorder_is_added_on_request_unless_the_scenario_disables_it() -> None:
    assert "recorder" in resolved().nodes
    assert "recorder" not in resolved(record=False).nodes
    path, content = scenario.load("baseline")
    content["run"] |= {"record": False}
    assert "recorder" not in scenario.resolve(path, content, frames=2, record=True).nodes
    content["run"] |= {"record": "yes"}
    with pytest.raises(ConfigurationError, match=r"run\.record.*'yes'.*False"):
        scenario.resolve(path, content, frames=2, record=True)


def test_lost_messages_are_reported_in_run_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mcap.writer import Writer

    def full(self: Writer) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "flush", full)
    outcome = launcher.run(resolved(), tmp_path / "run", runtime="inproc")
    assert isinstance(outcome.error, DiskFull)
    assert (tmp_path / "run" / "metrics.json").is_file(), "the run continues to its end"
    recorded = outcome.record["recorded"]
    assert recorded["messages"] == 0 < recorded["lost"]
    assert f"{recorded['lost']} messages" in outcome.record["message"]
