"""The example in docs/examples/ runs: a program that uses only Zenoh makes an agent's tracks and hears the picture."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.session import open_client
from mast_zenoh.messages import codec
from mast_zenoh.run_folder.recording.reader import read

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
FILES = {name: (EXAMPLES / name).read_text("utf-8") for name in ("zenoh_agent.py", "tracker.py", "with_tracker.py")}
FRAMES = 12
TRACKS = "agent/infra_1/tracks"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


@contextmanager
def program(folder: Path) -> Iterator[str]:
    """The program of the page; yields its endpoint."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, str(folder / "tracker.py"), endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        try:
            yield endpoint
        finally:
            process.kill()


def resolved(folder: Path, endpoint: str, *settings: str) -> Resolved:
    words = [f"endpoint={endpoint}", *settings]
    return scenario.resolve(*scenario.load(str(folder / "with_tracker.py"), words), frames=FRAMES, record=True)


def played(wanted: Resolved, out: Path, **options: Any) -> tuple[dict[str, Any], list[tuple[Any, ...]]]:
    """The record of a run and its messages, which must end well."""
    ended = launcher.run(wanted, out, **options)
    assert ended.error is None, ended.error
    return ended.record, sorted((each.frame, each.key, each.publisher, each.seq, each.payload) for each in read(out))


def test_a_program_makes_an_agents_tracks_and_the_run_is_exact_and_says_what_it_depends_on(folder: Path) -> None:
    with program(folder) as endpoint:
        wanted = resolved(folder, endpoint)
        record, alone = played(wanted, folder / "alone", runtime="inproc")
        _, mesh = played(wanted, folder / "mesh")
    assert alone == mesh
    counts = record["outside"]["infra_1"]
    assert (counts["asked"], counts["answered"], counts["refused"], counts["waits"]) == (FRAMES, FRAMES, {}, True)
    (notice,) = (each for each in record["notices"] if each["kind"] == "outside")
    assert notice["text"].startswith("infra_1 uses a")
    tracks = [codec.decode(payload, "tracks").body for _, key, *_, payload in alone if key == TRACKS]
    pictures = [codec.decode(payload, "picture").body for _, key, *_, payload in alone if key == "cc/picture"]
    assert set(tracks[-1]["id"].tolist()) & set(pictures[-2]["id"].tolist()), "it has heard the picture"
    assert pictures[-1]["support"].max() > 1, "its tracks are fused with those of others"


def test_what_is_no_message_costs_that_message_and_a_program_that_is_missing_is_named(folder: Path) -> None:
    with program(folder) as endpoint, open_client(endpoint) as stranger:
        wanted = resolved(folder, endpoint)

        def disturb(sample: zenoh.Sample) -> None:
            stranger.put("infra_1/tracks", b"no message")

        subscriber = stranger.declare_subscriber("infra_1/sent/detections", disturb)
        record, _ = played(wanted, folder / "disturbed", runtime="inproc")
        del subscriber
    counts = record["outside"]["infra_1"]
    assert counts["answered"] == FRAMES
    assert set(counts["refused"]) == {"tracks"}
    ended = launcher.run(wanted, folder / "missing", runtime="inproc")
    assert ended.error is not None
    assert "program of infra_1" in str(ended.error)


def test_a_run_goes_on_without_the_answers_of_a_program_that_has_ended(folder: Path) -> None:
    (folder / "tracker.py").write_text(
        FILES["tracker.py"]
        .replace("    seen = ", "    if header.frame == 5:\n        token.undeclare()\n    seen = ")
        .replace("    session.put(", "    header.frame < 5 and session.put(")
    )
    with program(folder) as endpoint:
        record, messages = played(resolved(folder, endpoint), folder / "alone", runtime="inproc")
    counts = record["outside"]["infra_1"]
    assert (counts["asked"], counts["answered"], counts["unanswered"]) == (FRAMES, 5, FRAMES - 5)
    assert counts["absent"] == {"infra_1/tracks": "from frame 5 on: no program has a token for it"}
    assert [frame for frame, key, *_ in messages if key == TRACKS] == list(range(FRAMES))
