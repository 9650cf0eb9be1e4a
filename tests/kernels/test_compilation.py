"""A build without kernels, and every run that is slower for it, says why."""

import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console
from tiny_world import tiny

from mast_zenoh import kernels
from mast_zenoh.config import loading
from mast_zenoh.deploy import doctor
from mast_zenoh.launch import run
from mast_zenoh.study import definition, trials

ROOT = Path(__file__).parents[2]
NO_COMPILER = "there is no C compiler: command 'cc' failed"

#: pip calls the hook while it handles an error of its own.
BUILD = """
import hatch_build, pathlib, sys
try:
    raise AttributeError("of pip")
except AttributeError:
    built, reason = hatch_build.compiled(pathlib.Path.cwd(), pathlib.Path("out"))
print("reason:", len(built), reason)
"""


@pytest.mark.parametrize(
    ("compiler", "reason"),
    [
        ("", " 1 \n"),
        ("echo 'cc1: fatal error: no space' >&2; exit 1", "compiler failed: cc1"),
        ("no-such-compiler", "compiler: [Errno 2]"),
    ],
    ids=["a working compiler", "an error", "no compiler"],
)
def test_a_build_keeps_the_compilers_last_line(tmp_path, compiler, reason):
    pytest.importorskip("hatchling")
    if not compiler and not kernels.COMPILED:
        pytest.skip("there is no C compiler here")
    folder = tmp_path / "mast_zenoh" / "kernels"
    folder.mkdir(parents=True)
    for name in ("source_digest.py", "table_columns.py"):
        shutil.copy(ROOT / "mast_zenoh" / "kernels" / name, folder)
    (folder / "small.pyx").write_text("def twice(int number):\n    return 2 * number\n")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    if " " in compiler:
        script = tmp_path / "compiler"
        script.write_text(f"#!/bin/sh\n{compiler}\n")
        script.chmod(0o755)
        compiler = str(script)
    if compiler:
        environment["CC"] = compiler
    done = subprocess.run(
        [sys.executable, "-c", BUILD], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert reason in done.stdout.partition("reason:")[2], done.stdout + done.stderr


@pytest.mark.parametrize(
    ("output", "reason"),
    [
        (
            "x.c:4:10: fatal error: Python.h: No such file or directory\n    4 | #include\ncompilation terminated.\n",
            "the headers of",
        ),
        (
            "x.c:1: warning: w\nx.c:9:2: error: unknown type name 'flaot'\n",
            "the C compiler",
        ),
    ],
)
def test_the_reason_of_a_failed_build_is_the_last_error(output, reason):
    hatch_build = pytest.importorskip("hatchling") and loading.module(ROOT / "hatch_build.py")
    assert hatch_build.why(subprocess.CalledProcessError(1, ["cc"]), output).startswith(reason)


@pytest.mark.parametrize(
    ("compiled", "reason", "first"),
    [
        ({}, NO_COMPILER, f"compiled kernels are not used, which is slower: {NO_COMPILER}; to get them, {kernels.HOW}"),
        (
            {"predict": print},
            "MAST_KERNELS=numpy disables them",
            "compiled kernels are not used, which is slower: MAST_KERNELS=numpy disables them",
        ),
    ],
    ids=["not compiled", "disabled"],
)
def test_the_first_line_of_a_run_and_its_record_say_why_kernels_are_not_used(
    monkeypatch, tmp_path, compiled, reason, first
):
    page = io.StringIO()
    monkeypatch.setattr(kernels, "COMPILED", compiled)
    monkeypatch.setattr(kernels, "why_not", lambda: reason)
    run.run(tiny(frames=2), tmp_path / "run", runtime="inproc", console=Console(file=page, width=80))
    assert page.getvalue().splitlines()[0] == first
    assert json.loads((tmp_path / "run" / "run.json").read_text())["kernels_not_used"] == reason
    finding = doctor.compiled_kernels()
    assert (finding.ok, reason in finding.detail, "cpm" in finding.detail) == (None, True, True)
    assert finding.fix == ("unset MAST_KERNELS" if compiled else kernels.HOW)


def test_the_first_line_of_a_study_says_why_kernels_are_not_used(monkeypatch, tmp_path):
    page = io.StringIO()
    monkeypatch.setattr(kernels, "notice", lambda: "kernels are not used [cc]")
    (tmp_path / "one.py").write_text(
        "def study():\n    return dict(name='one', runs=dict(a=dict(scenario='baseline')), trials=1, frames=2)"
    )
    study = definition.load(str(tmp_path / "one.py"))
    trials.run(study, tmp_path / "out", count=1, console=Console(file=page, width=80))
    assert "not used [cc]" in page.getvalue().splitlines()[0]


def test_a_run_with_compiled_kernels_says_nothing_of_them(monkeypatch, tmp_path):
    page = io.StringIO()
    monkeypatch.setattr(kernels, "why_not", lambda: "")
    run.run(tiny(frames=2), tmp_path / "run", runtime="inproc", console=Console(file=page, width=80))
    assert "kernels" not in page.getvalue()
    assert "kernels_not_used" not in json.loads((tmp_path / "run" / "run.json").read_text())


def test_make_tells_what_pip_hides(tmp_path):
    if not shutil.which("make"):
        pytest.skip("make is not installed")
    for name, command in {"pip": "true", "python": f'{sys.executable} "$@"'}.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{command}\n")
        (tmp_path / name).chmod(0o755)
    done = subprocess.run(
        ["make", "--silent", "--old-file=.venv/installed", f"BIN={tmp_path}", "kernels"],
        cwd=ROOT,
        env=os.environ | {"MAST_KERNELS": "numpy"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "which is slower" in done.stdout
