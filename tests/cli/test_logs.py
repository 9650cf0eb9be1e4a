"""`mast logs` prints the logs of a run, whatever nodes have written into them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from launched import eventually

from mast_zenoh.launch import liveness, log_reading
from mast_zenoh.launch.log_reading import MAX_LINE


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    """A run that this process seems to have launched, and that goes on."""
    folder = tmp_path / "a_run"
    (folder / "logs").mkdir(parents=True)
    record = {"status": "running", "launcher": liveness.identity(), "nodes": {"ego": {}, "broker": {}, "idle": {}}}
    (folder / "run.json").write_text(json.dumps(record))
    write(folder, "ego", "2026-01-01 00:00:01,000 WARNING mast.ego: one\n2026-01-01 00:00:03,000 INFO mast.ego: three")
    write(folder, "broker", "2026-01-01 00:00:02,000 ERROR mast.broker: two\nTraceback:\n  File x\n")
    return folder


def write(folder: Path, node: str, text: str, mode: str = "a") -> None:
    with (folder / "logs" / f"{node}.log").open(mode) as file:
        file.write(text)


def end(folder: Path) -> None:
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"status": "ok"}))


def test_logs_of_all_nodes_are_in_the_order_of_time_with_their_names(mast, run_folder: Path) -> None:
    code, out, err = mast("logs", str(run_folder))
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        "ego  2026-01-01 00:00:01,000 WARNING mast.ego: one",
        "broker  2026-01-01 00:00:02,000 ERROR mast.broker: two",
        "broker  Traceback:",
        "broker    File x",
        "ego  2026-01-01 00:00:03,000 INFO mast.ego: three",
    ]


def test_the_log_of_one_node_is_printed_as_it_is_and_an_unknown_node_or_folder_refused(
    mast, run_folder: Path, tmp_path: Path
) -> None:
    assert mast("logs", str(run_folder), "broker")[1].splitlines()[1:] == ["Traceback:", "  File x"]
    assert mast("logs", str(run_folder), "idle") == (0, "", "idle has not written to its log\n")
    for words, reason in (
        ((str(run_folder), "brokr"), "has no node 'brokr'; did you mean 'broker'?"),
        ((str(tmp_path),), "expected the folder of a run"),
        ((str(tmp_path / "nowhere"),), "expected the folder of a run"),
    ):
        code, out, err = mast("logs", *words)
        assert (code, out) == (15, "")
        assert reason in err.replace("\n", " ")


def test_control_characters_of_a_node_do_not_reach_the_terminal(mast, run_folder: Path) -> None:
    write(run_folder, "ego", "\x1b[2J\x1b]0;owned\x07 [bold]as it is[/] \r\x9b \u202egnol\ttab\n", "w")
    _, out, _ = mast("logs", str(run_folder), "ego")
    assert out == "\\x1b[2J\\x1b]0;owned\\x07 [bold]as it is[/] \\r\\x9b \\u202egnol\ttab\n"


def test_damaged_and_missing_logs_cost_nothing_but_themselves(mast, run_folder: Path) -> None:
    (run_folder / "logs" / "ego.log").write_bytes(b"\xff\xfe\x00 bytes\n" + b"x" * (MAX_LINE + 5))
    (run_folder / "logs" / "folder.log").mkdir()
    (run_folder / "run.json").write_text("{damaged")
    code, out, err = mast("logs", str(run_folder))
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "ego  \\xff\\xfe\\x00 bytes"
    assert [len(line) for line in lines if line.startswith("ego  x")] == [MAX_LINE + 5, 5 + 5]
    assert "broker  Traceback:" in lines


def test_of_a_log_that_is_too_long_the_last_lines_are_printed_and_the_rest_is_told(
    mast, run_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_reading, "MAX_LOG_BYTES", 100)
    write(run_folder, "ego", "".join(f"line {number}\n" for number in range(1000)), "w")
    code, out, err = mast("logs", str(run_folder), "ego")
    assert code == 0
    assert out.splitlines() == [f"line {number}" for number in range(989, 1000)]
    assert "left out" in err.replace("\n", " ")


def test_all_logs_together_are_bounded(mast, run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_reading, "MAX_LOGS_BYTES", 1000)
    for number in range(20):
        write(run_folder, f"node_{number}", "a line of the log\n" * 100)
    _, out, err = mast("logs", str(run_folder))
    assert sum(len(line.partition("  ")[2]) for line in out.splitlines()) <= 1000
    assert err.count("are left out") == 22


def test_a_log_of_many_gigabytes_is_read_in_a_moment(mast, run_folder: Path) -> None:
    with (run_folder / "logs" / "ego.log").open("ab") as file:
        file.truncate(1 << 40)
        file.seek(0, os.SEEK_END)
        file.write(b"\n2026-01-01 00:00:09,000 INFO mast.ego: the end")
    code, out, err = mast("logs", str(run_folder), "ego")
    assert code == 0
    assert out.endswith("mast.ego: the end\n")
    assert "are left out" in err.replace("\n", " ")


@pytest.fixture
def following(run_folder: Path):
    """`mast logs RUN -f` in its own process, which has printed the lines up to now."""
    command = (sys.executable, "-m", "mast_zenoh", "logs", str(run_folder), "-f")
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            for _ in range(4):
                process.stdout.readline()
            yield process
        finally:
            process.kill()


def test_new_lines_follow_until_the_run_ends(following: subprocess.Popen[str], run_folder: Path) -> None:
    write(run_folder, "ego", " and more\n")
    assert following.stdout.readline() == "ego  2026-01-01 00:00:03,000 INFO mast.ego: three and more\n"
    write(run_folder, "late", "it has joined\n")
    assert following.stdout.readline() == "late  it has joined\n"
    write(run_folder, "late", "without a line feed")
    end(run_folder)
    out, err = following.communicate(timeout=60)
    assert (out, err, following.returncode) == ("late  without a line feed\n", "", 0)


def test_ctrl_c_ends_following(following: subprocess.Popen[str]) -> None:
    following.send_signal(signal.SIGINT)
    out, err = following.communicate(timeout=60)
    assert (out, err, following.returncode) == ("", "", 0)


def test_following_ends_when_nobody_reads(following: subprocess.Popen[str], run_folder: Path) -> None:
    following.stdout.close()

    def ended() -> bool:
        write(run_folder, "ego", "\nnobody reads this\n")
        return following.poll() is not None

    eventually(ended, "it has noticed the closed pipe")
    assert following.returncode == 0
