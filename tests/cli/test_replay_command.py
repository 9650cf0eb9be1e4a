"""`mast replay` on the command line: what it says, and what it refuses."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny_world import tiny

from mast_zenoh.launch import run as launcher

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The folder of a recorded run."""
    resolved = tiny("baseline", frames=4, record=True)
    return str(launcher.run(resolved, tmp_path_factory.mktemp("recorded") / "run", runtime="inproc").folder)


def test_it_says_what_is_played_what_is_live_and_what_is_missing(mast: Command, recorded: str, tmp_path: Path) -> None:
    file = Path(recorded) / "run.json"
    original = file.read_text()
    file.write_text(json.dumps(json.loads(original) | {"status": "stalled"}))
    settings = ("--set", "broker.patience=1", "--runtime", "inproc", "--no-report", "--out", "out")
    code, out, err = mast("replay", recorded, *settings, "--against", recorded)
    file.write_text(original)
    assert code == 0
    assert out.startswith("played: ego, infra_1,")
    assert "ended as 'stalled'" in err
    assert "ended as 'stalled'" in out
    assert "brackets: more" in " ".join(out.split())
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["replay"]["changed"] == {"broker": ["patience"]}


@pytest.mark.parametrize(
    ("words", "code", "reason"),
    [
        (("--mode", "lockstep", "--rate", "2"), 2, "lock-step waits"),
        (("--rate", "2", "--runtime", "inproc"), 2, "real time needs"),
        (("--rate", "0"), 10, "rate: found 0.0"),
        (("--against", "twin"), 2, "replay has no"),
        (("--from", "broker"), 2, "not one"),
        (("--times", "0"), 2, "equal to 1"),
        (("--secure", "--runtime", "inproc"), 2, "process has no"),
        (("--scenario", "nosuch"), 10, "no such file"),
        (("--set", "x=1"), 10, "no launch-time parameters"),
    ],
)
def test_what_is_impossible_is_refused_before_anything_starts(
    mast: Command, recorded: str, tmp_path: Path, words: tuple[str, ...], code: int, reason: str
) -> None:
    exit_code, _, err = mast("replay", recorded, *words, "--out", "out")
    assert exit_code == code
    assert reason in " ".join(err.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def test_a_folder_without_a_recording_is_refused_with_15(mast: Command, tmp_path: Path) -> None:
    code, _, err = mast("replay", str(tmp_path))
    assert code == 15
    assert "messages.mcap: missing" in err.replace("\n", "")
