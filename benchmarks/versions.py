"""Processes that run scenarios with this version of the package, or with that of another commit."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from contextlib import AbstractContextManager
from io import BytesIO
from pathlib import Path

from cost import RUNS

from mast_zenoh import scenario
from mast_zenoh.launch import run as launcher
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.mesh.security.levels import SECURE

ROOT = Path(__file__).resolve().parents[1]
BUILT = ROOT / ".venv" / "versions"
LEVELS = {"mesh": "open", "secured": SECURE}


def git(*arguments: str) -> bytes:
    """The output of a git command here."""
    return subprocess.run(["git", *arguments], cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout


def commit_of(name: str | None) -> str:
    """A commit: that of a name, or else the last release, or the one before this if there is none."""
    if not name:
        tags = git("tag", "--merged", "HEAD", "--sort=-creatordate").decode().split()
        name = tags[0] if tags else "HEAD~1"
    try:
        return git("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}").decode().strip()
    except subprocess.CalledProcessError:
        sys.exit(f"{name}: not a commit of this repository; git log --oneline lists them")


def built(commit: str) -> Path:
    """A folder with the package of a commit, compiled; the last one is kept."""
    folder = BUILT / commit
    if not folder.exists():
        shutil.rmtree(BUILT, ignore_errors=True)
        BUILT.mkdir(parents=True)
        with tempfile.TemporaryDirectory(dir=BUILT) as temporary:
            source, package = Path(temporary) / "source", Path(temporary) / "package"
            with tarfile.open(fileobj=BytesIO(git("archive", commit))) as archive:
                archive.extractall(source, filter="data")
            build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", temporary]
            subprocess.run(build, cwd=source, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
            (wheel,) = Path(temporary).glob("*.whl")
            with zipfile.ZipFile(wheel) as files:
                files.extractall(package)
            package.rename(folder)
    return folder


class Version(AbstractContextManager["Version"]):
    """A process that runs so many frames of scenarios with the package in a folder."""

    def __init__(self, package: Path, frames: int) -> None:
        self._package = package
        self._frames = frames

    def __enter__(self) -> Version:
        self._process = subprocess.Popen(
            [sys.executable, __file__, str(self._frames)],
            env=os.environ | {"PYTHONPATH": str(self._package)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(self, *error: object) -> None:
        self._process.communicate()

    def seconds(self, runtime: str, run: str) -> float:
        """Seconds that a frame of a run takes: of processor time in one process, on the wall clock on a mesh.

        runtime: "inproc", "mesh" or "secured"
        """
        assert self._process.stdin
        assert self._process.stdout
        print(runtime, run, file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"{self._package}: {runtime} {run} failed, see above")
        return float(answer)


def serve() -> None:
    """Main function of such a process: runs what standard input names, and answers with the seconds of a frame."""
    frames, resolved = int(sys.argv[1]), {}
    for run, (name, settings) in RUNS.items():
        path, loaded = scenario.load(name, settings)
        resolved[run] = scenario.resolve(path, loaded, frames=frames)
    for line in sys.stdin:
        runtime, run = line.split()
        if runtime == "inproc":
            process = InProcess(resolved[run])
            began = time.process_time()
            process.run()
            print((time.process_time() - began) / frames, flush=True)
        else:
            with tempfile.TemporaryDirectory() as folder:
                finished = launcher.run(resolved[run], Path(folder) / "run", secure=LEVELS[runtime])
            print(1.0 / finished.record["timings"]["frames_per_second"], flush=True)


if __name__ == "__main__":
    serve()
