"""The command line reports errors and exits as in docs/ref-exit-codes.md."""

import errno
import json
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import failing
import pytest
from rich.table import Table

import mast_zenoh as testbed
from mast_zenoh.cli import options
from mast_zenoh.cli.console import PlainConsole
from mast_zenoh.errors import DiskFull, HandlerFailed, MastError, RunFolderError
from mast_zenoh.launch.run import EndedRun
from mast_zenoh.scenario.reading import load
from mast_zenoh.show.page.page import viewer_page

SHORT = ("--frames", "4", "--runtime", "inproc")


@pytest.mark.usefixtures("unpainted")
def test_a_run_in_one_process_leaves_a_run_folder_a_recording_and_a_report(mast, tmp_path: Path) -> None:
    code, out, _ = mast("run", "baseline", *SHORT, "--out", "a")
    assert code == 0
    assert "report:" in out
    names = {"run.json", "metrics.json", "report.html", "messages.mcap"}
    assert {path.name for path in (tmp_path / "a").iterdir()} >= names
    record = json.loads((tmp_path / "a" / "run.json").read_text())
    assert (record["status"], record["frames"]) == ("ok", 4)
    assert mast("run", "baseline", *SHORT, "--no-report", "--no-record", "--out", "b")[0] == 0
    assert not {"report.html", "messages.mcap"} & {path.name for path in (tmp_path / "b").iterdir()}
    assert mast("diff", "a", "a")[0] == 0
    code, _, err = mast("diff", "a", "b")
    assert code == 2
    assert "b/messages.mcap: missing; b" in err.replace("\n", "")


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("run",), 2, "Missing argument"),
        (("ruin", "baseline"), 2, "No such command"),
        (("run", "baseline", "--frames", "0"), 2, "--frames"),
        (("run", "baseline", "--runtime", "cloud"), 2, "--runtime"),
        (("run", "baseline", *SHORT, "--mode", "realtime"), 2, "--mode"),
        (("run", "baseline", *SHORT, "--debug-protocol"), 2, "no protocol"),
        (("run", "basline"), 10, "mean 'baseline.py'"),
        (("run", "baseline", "--set", "n_infrastructre=3"), 10, "mean 'n_infrastructure'"),
        (("run", "uncoordinated", "--set", "n_adversaries=9"), 10, "n_adversaries: found 9"),
        (("run", "baseline", "--set", "keyexpr.map=testbd.toml"), 11, "mean 'testbed.toml'"),
        (("run", "baseline", "--set", "broker.file='brokr.py'"), 12, "mean 'broker.py'"),
        (("run", "baseline", "--set", "scene=av2:no/such/log"), 13, "no/such/log"),
        (("study", "case_stdy"), 10, "mean 'case_study.py'"),
        (("study", "case_study", "--set", "n_adversary=1"), 10, "mean 'n_adversaries'"),
        (("wiring", "baseline", "--format", "xml"), 2, "--format"),
        (("study", "defences", "--set", "adversaries=nosuch.py:Liar"), 10, "no such file"),
        (("replay", __file__), 15, "test_cli.py: found"),
        (("report", "nowhere"), 15, "nowhere"),
        (("diff", "nowhere", "nowhere"), 2, "cannot compare: nowhere"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_errors_are_reported_before_anything_starts(
    mast, tmp_path: Path, words: tuple[str, ...], code: int, message: str
) -> None:
    exit_code, out, err = mast(*words)
    assert (exit_code, message in (out + err).replace("\n", " ")) == (code, True), out + err
    assert "Traceback" not in err
    assert not (tmp_path / "runs").exists()


def test_the_listing_of_the_paper_runs_unchanged(mast, tmp_path: Path) -> None:
    (tmp_path / "paper.py").write_text(
        """
from mast_zenoh.config import loading
_, baseline = loading.function("scenarios", "baseline", "scenario")

commandcenter = dict(
    type="CommandCenter",
    pipeline=dict(
        type="CommandCenterPipeline",
        clustering=dict(type="SampledAssignmentClusterer", assign_radius=2.0),
        group_tracking=dict(
            type="GroupTrackerWrapper",
            fusion=dict(type="CovarianceIntersectionFusion"),
            tracker=dict(type="KalmanBoxTracker3D"),
        ),
    ),
)

def scenario():
    made = baseline()
    del made["command_center"]
    return made | dict(commandcenter=commandcenter)
"""
    )
    assert mast("run", "paper.py", *SHORT, "--no-report", "--out", "paper")[0] == 0
    # Ours says that the agents' errors are mostly independent; the paper's fusion assumes nothing.
    published = "command_center.pipeline.group_tracking.fusion.independent_share=0.0"
    assert mast("run", "baseline", *SHORT, "--set", published, "--no-report", "--out", "ours")[0] == 0
    assert (tmp_path / "paper" / "metrics.json").read_bytes() == (tmp_path / "ours" / "metrics.json").read_bytes()


def test_the_wiring_is_shown_in_three_forms(mast) -> None:
    code, out, _ = mast("wiring", "uncoordinated", "--set", "n_adversaries=1")
    assert code == 0
    assert "[adversary_1]" in out
    assert "recorder subscribes" in out
    assert out.count("recorder") == 1
    code, out, _ = mast("wiring", "uncoordinated", "--set", "n_adversaries=1", "--format", "json")
    wires = {wire["key"]: wire for wire in json.loads(out)["wires"]}
    assert wires["agent/infra_1/detections"]["interposers"] == ["adversary_1"]
    assert wires["agent/infra_2/detections"]["interposers"] == []
    code, out, _ = mast("wiring", "uncoordinated", "--format", "mermaid")
    assert out.startswith("flowchart LR")


def test_ctrl_c_in_one_process_keeps_the_results_obtained_so_far(
    mast, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import os
    import signal

    from mast_zenoh.launch.display import Display

    def update(self: Display, frame: int, states: object) -> None:
        if frame == 3:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(Display, "update", update)
    code, _, err = mast("run", "baseline", "--frames", "9", "--runtime", "inproc", "--no-report", "--out", "cut")
    assert code == 130
    assert "stopped by Ctrl-C" in err
    assert json.loads((tmp_path / "cut" / "run.json").read_text())["status"] == "interrupted"
    assert json.loads((tmp_path / "cut" / "metrics.json").read_text())["frames"] == 3


@pytest.mark.usefixtures("without_figures")
def test_a_failed_handler_gives_exit_code_30_and_is_named_unless_allowed(mast, tmp_path: Path) -> None:
    path = str(failing.write("attack", tmp_path))
    short = ("--frames", "8", "--runtime", "inproc")
    code, _, err = mast("run", path, *short, "--no-report", "--out", "loud")
    assert code == 30
    description = "eve.on_detections failed 3 times in 3 frames (5 to 7): ValueError: no [plan] for frame 5 ("
    assert description in err
    assert f"{tmp_path / 'loud' / 'logs' / 'eve.log'}" in err
    code, _, err = mast("report", "loud")
    assert code == 0
    assert "warning: Handlers" in err
    code, _, err = mast("run", path, *short, "--no-report", "--out", "allowed", "--allow-failures")
    assert code == 0
    assert f"wrong:\n  {description}" in err


@pytest.mark.usefixtures("without_figures")
def test_a_run_is_compared_with_its_unattacked_twin(mast, tmp_path: Path) -> None:
    attack = ("--set", "attack_start_s=0", "--frames", "12", "--runtime", "inproc")
    code, out, _ = mast("run", "uncoordinated", *attack, "--out", "here", "--against", "twin")
    assert code == 0
    assert (tmp_path / "here" / "twin" / "metrics.json").is_file()
    assert "than unattacked" in out.replace("\n", " ")
    assert "compared with unattacked" in (tmp_path / "here" / "report.html").read_text()
    assert mast("report", "here")[0] == 0
    assert "compared with unattacked" not in (tmp_path / "here" / "report.html").read_text()


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("name", ["attack", "center"])
def test_failures_in_a_comparison_are_reported_and_give_exit_code_30_unless_allowed(
    mast, tmp_path: Path, name: str
) -> None:
    path = str(failing.write(name, tmp_path))
    short = ("--frames", "12", "--runtime", "inproc", "--against", "twin")
    code, out, err = mast("run", path, *short, "--out", "loud")
    assert code == 30
    assert ("eve.on_detections failed" if name == "attack" else "no clusters") in err
    assert "report:" in out
    assert "more than unattacked" in out.replace("\n", " ")
    prefix = "compared with unattacked, which failed"
    page = (tmp_path / "loud" / "report.html").read_text()
    assert (prefix in out, prefix in page.lower()) == ((name == "center"),) * 2
    code, out, err = mast("run", path, *short, "--no-report", "--out", "allowed", "--allow-failures")
    assert code == 0
    assert "warning: handlers failed" in err
    assert "more than unattacked" in out.replace("\n", " ")
    assert (prefix in out) == (name == "center")


@pytest.mark.heavy
def test_a_run_that_cannot_be_compared_keeps_its_results_and_its_own_error(mast, tmp_path: Path) -> None:
    path = str(failing.write("attack", tmp_path))
    assert mast("run", "baseline", *SHORT, "--no-report", "--out", "other")[0] == 0
    code, out, err = mast("run", path, "--frames", "8", "--runtime", "inproc", "--out", "loud", "--against", "other")
    assert code == 30
    assert "report:" in out
    assert "warning: not compared: " in err
    code, out, err = mast("run", "baseline", "--frames", "5", *SHORT[2:], "--out", "long", "--against", "other")
    assert code == 17
    assert "report:" in out
    assert "NotComparable" in err
    code, _, err = mast("report", "long", "--against", "other")
    assert (code, "found 5 and 4 frames" in err.replace("\n", " ")) == (17, True)


@pytest.mark.parametrize("words", [("run", "baseline", *SHORT), ("replay", "recorded"), ("report", "recorded")])
def test_an_impossible_comparison_is_refused_before_anything_is_done(mast, tmp_path: Path, words) -> None:
    for name in ("empty", "unscored", "damaged"):
        (tmp_path / name).mkdir()
        if name != "empty":
            (tmp_path / name / "run.json").write_text("{}")
    (tmp_path / "damaged" / "metrics.json").write_text("{")
    (tmp_path / "file").touch()
    out = () if words[0] == "report" else ("--out", "here")
    for name, problem in {
        "nosuch": "found no such folder",
        "file": "found a file",
        "file/metrics.json": "found no such folder",
        "empty": "has no run.json",
        "unscored": "has no metrics.json",
        "damaged": "has a damaged metrics.json",
    }.items():
        code, _, err = mast(*words, *out, "--against", name)
        assert (code, f"{name}: {problem}: expected" in err.replace("\n", " ")) == (17, True), err
    assert not (tmp_path / "here").exists()


def test_output_of_a_node_and_names_in_tables_cannot_move_the_cursor_or_change_the_terminal() -> None:
    text, table_text, table = StringIO(), StringIO(), Table("run")
    console = PlainConsole(file=text, force_terminal=True)
    console.print("[bold]a\x1b]0;title\x07b\x1b[2J\rc\u202ed", style="red", highlight=False)
    assert "a�]0;title�b�[2J�c�d" in text.getvalue()
    assert text.getvalue().startswith("\x1b["), "the console's own styling stays"
    table.add_row("a\x1b]0;title\x07b\x9b2J\u202ec")
    PlainConsole(file=table_text).print(table)
    assert not {"\x1b", "\x07", "\x9b", "\u202e"} & {*table_text.getvalue()}


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("show", "error", "expected", "message"),
    [
        (lambda *_, **__: {}["agents"], None, RunFolderError, "KeyError"),
        (lambda *_, **__: {}["agents"], HandlerFailed("its own"), HandlerFailed, "its own"),
        (full, HandlerFailed("its own"), HandlerFailed, "its own"),
        (full, None, DiskFull, r"complete except.*report"),
    ],
)
def test_a_failing_report_hides_no_error_of_its_run_and_calls_no_failed_run_complete(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    show: Callable[..., None],
    error: MastError | None,
    expected: type[MastError],
    message: str,
) -> None:
    monkeypatch.setattr(options, "_show", show)
    with pytest.raises(expected, match=message):
        options.conclude(EndedRun(tmp_path, {"nodes": {}, "message": ""}, error), report=True)
    told = " ".join(capsys.readouterr().err.split())
    assert "complete" not in told
    assert ("failed run, without" in told) == (show is full and error is not None)


@pytest.mark.heavy
def test_a_defended_run_is_compared_with_the_same_run_without_its_fault(mast, tmp_path: Path) -> None:
    _, scenario = load("defended", ["defence=FaultOrLie", "attack_start_s=0.5", "n_infrastructure=2"])
    fault = dict(type="BlindSector", node="infra_1", at=0.5, azimuth_min_deg=-60.0, azimuth_max_deg=60.0)
    faulted, sound = (
        testbed.run(scenario | dict(faults=faults), frames=40, seed=5, out=tmp_path / name)
        for name, faults in (("faulted", [fault]), ("sound", []))
    )
    code, out, err = mast("report", "faulted", "--against", "sound")
    assert code == 0, err
    assert "than sound" in " ".join(out.split())
    compared = testbed.compare(sound, faulted)
    assert " ".join(compared.headline.split()) in " ".join(str(compared).split())
    assert len(set(compared.table["run"].to_pylist())) == 2
    assert "defended and sound" in viewer_page([faulted.path, sound.path]).decode()
