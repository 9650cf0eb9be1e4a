"""The host's side of `installation`: a program by itself, which the host's Python reads from its standard input.

    python3 - probe FOLDER ENVIRONMENT RELEASE     what this host is, as JSON
    python3 - unpack NEW TARGET VENV               wheels in NEW become TARGET, with a virtual environment if VENV is 1
    python3 - verify ENVIRONMENT RELEASE           imports what nodes import; says which mast-zenoh it is
    python3 - reach HOST PORT                      whether something answers there
    python3 - remove FOLDER                        a run's folder, whoever has left it

Nothing is half there: what is unpacked gets its name when it is whole. So hosts may share a home.
"""

from __future__ import annotations

import contextlib
import glob
import json
import os
import platform
import shutil
import socket
import subprocess
import sys
import zipfile
from typing import Any

_SAY_VERSION = "from mast_zenoh import version; print(version.version_string())"
_IMPORT_ALL = "import mast_zenoh.runtime.remote_node, mast_zenoh.tracking, mast_zenoh.pipelines; "


def probe(folder: str, environment: str, release: str) -> dict[str, Any]:
    """What this host is, and what of ours it has."""
    folder = os.path.join(os.path.expanduser("~"), folder)
    found: dict[str, Any] = {
        "folder": folder,
        "system": platform.system(),
        "machine": platform.machine(),
        "refused": "",
        "version": "",
    }
    try:
        os.makedirs(os.path.join(folder, "runs"), mode=0o700, exist_ok=True)
        for name in ("environments", "releases"):
            os.makedirs(os.path.join(folder, name), exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise OSError("may not be written to")
        found["free"] = shutil.disk_usage(folder).free
        _sweep(os.path.join(folder, "runs"))
    except OSError as error:
        found["refused"] = str(error)
        return found
    environment, release = (
        os.path.join(folder, kind, name) for kind, name in (("environments", environment), ("releases", release))
    )
    found["environment"], found["release"] = os.path.exists(environment), os.path.exists(release)
    if found["environment"] and found["release"]:
        found["version"] = _run(environment, release, _SAY_VERSION)
    return found


def unpack(new: str, target: str, venv: str) -> dict[str, Any]:
    """Wheels are archives: pip is not needed to unpack them, so no host needs it."""
    place = os.path.join(new, "content")
    if venv == "1":
        subprocess.check_call([sys.executable, "-m", "venv", "--without-pip", place])
        (place_of_wheels,) = glob.glob(os.path.join(place, "lib", "python*", "site-packages"))
    else:
        os.mkdir(place)
        place_of_wheels = place
    for wheel in glob.glob(os.path.join(new, "*.whl")):
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(place_of_wheels)
        os.unlink(wheel)
    for data in glob.glob(os.path.join(place_of_wheels, "*.data", "*lib")):  # PEP 427: purelib and platlib
        for name in os.listdir(data):
            shutil.move(os.path.join(data, name), place_of_wheels)
    try:
        os.rename(place, target)
    except OSError:
        if not os.path.exists(target):
            raise
    shutil.rmtree(new)  # with `place`, if somebody else was quicker
    return {}


def verify(environment: str, release: str) -> dict[str, Any]:
    """Imports what nodes import, once for all of them: what is compiled then stays."""
    return {"version": _run(environment, release, _IMPORT_ALL + _SAY_VERSION)}


def reach(host: str, port: str) -> dict[str, Any]:
    """Whether something answers there, from here."""
    try:
        socket.create_connection((host, int(port)), timeout=10.0).close()
    except OSError as error:
        return {"refused": str(error)}
    return {"refused": ""}


def remove(folder: str) -> dict[str, Any]:
    """What a supervisor that was killed has left."""
    if os.path.basename(os.path.dirname(os.path.dirname(folder))) != "runs":
        raise SystemExit(f"{folder} is not the folder of a run")
    shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        os.rmdir(os.path.dirname(folder))
    return {}


def _run(environment: str, release: str, program: str) -> str:
    command = [os.path.join(environment, "bin", "python"), "-c", program]
    done = subprocess.run(command, env=dict(os.environ, PYTHONPATH=release), capture_output=True, check=False)
    said = (done.stdout if done.returncode == 0 else done.stderr).decode(errors="replace").strip().splitlines()
    return said[-1] if said else f"exit code {done.returncode}"


def _sweep(runs: str) -> None:
    """Remove folders of runs whose supervisor has gone without an end, as when the host was switched off."""
    for control in glob.glob(os.path.join(runs, "*", "*", "control")):
        folder, before = os.path.dirname(control), os.getcwd()
        with socket.socket(socket.AF_UNIX) as there:
            there.settimeout(5.0)
            os.chdir(folder)  # a socket's path may not be long
            try:
                there.connect("control")
            except ConnectionRefusedError:
                # One that shares this home from another host refuses as well: it touches its socket while it lives.
                if os.stat("control").st_mtime + 60.0 < _now(runs):
                    remove(folder)
            except OSError:
                pass
            finally:
                os.chdir(before)


def _now(folder: str) -> float:
    """The time as the file system has it: clocks of hosts may differ."""
    probed = os.path.join(folder, f".now-{os.getpid()}")
    open(probed, "w").close()
    try:
        return os.stat(probed).st_mtime
    finally:
        os.unlink(probed)


if __name__ == "__main__":
    os.umask(os.umask(0o022) | 0o022)
    programs: dict[str, Any] = {each.__name__: each for each in (probe, unpack, verify, reach, remove)}
    print(json.dumps(programs[sys.argv[1]](*sys.argv[2:])))
