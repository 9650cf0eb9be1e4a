"""Whether a process, and the launcher of a run.json, is alive. Imports nothing slow: supervisors on hosts use it."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh.errors import RunFolderError, UntrustedCode
from mast_zenoh.launch.ending import KILLED, RUNNING

if TYPE_CHECKING:
    from mast_zenoh.config.loading import AllowedCode


def identity() -> dict[str, Any]:
    """This process for run.json: id, start (clock ticks since boot), machine and boot."""
    return {"pid": os.getpid(), "began": began(os.getpid()), **_here()}


def lives(launcher: Mapping[str, Any]) -> bool | None:
    """Whether the launcher of a run is alive; None if that cannot be known from here."""
    here = _here()
    if launcher.get("machine") != here["machine"] or not isinstance(launcher.get("pid"), int):
        return None
    if launcher.get("boot") != here["boot"]:
        return False  # the machine has been rebooted since
    if launcher.get("pid_namespace") != here["pid_namespace"]:
        return None  # in a container, for example
    its_began = began(launcher["pid"])
    return its_began is not None and its_began == launcher.get("began")


def check_from_here(folder: Path, record: Mapping[str, Any], allowed: AllowedCode, named: str) -> None:
    """Raise UntrustedCode unless a run was started on this machine since it was booted, or its folder is confirmed.

    A folder from elsewhere must not make this machine connect to a host, or change containers, that it names: nobody
    can guess the id of a boot. named: what the folder names, for the message
    """
    launcher = record.get("launcher")
    launcher = launcher if isinstance(launcher, Mapping) else {}
    here = _here()
    if allowed.confirmed or (here["boot"] and all(launcher.get(key) == here[key] for key in ("machine", "boot"))):
        return
    raise UntrustedCode(
        f"{folder}: was not written by a run of this machine since it was started, and names {named}: nothing was "
        "contacted; if you trust it, confirm it with --trust"
    )


def is_own(file: Path, record: Mapping[str, Any]) -> bool:
    """Whether a run is going on here that this user has started. file: run.json, which holds the record"""
    launcher = record.get("launcher")
    if not isinstance(launcher, Mapping) or not lives(launcher):
        return False
    try:
        return {file.stat().st_uid, Path(f"/proc/{launcher['pid']}").stat().st_uid} == {os.getuid()}
    except OSError:
        return False


def current_record(record: Mapping[str, Any]) -> dict[str, Any]:
    """run.json as of now: a `running` run whose launcher is dead is `killed`."""
    launcher = record.get("launcher")
    if record.get("status") == RUNNING and isinstance(launcher, Mapping) and lives(launcher) is False:
        message = "its launcher was killed: what was recorded up to then is kept"
        return {**record, "status": KILLED, "message": record.get("message") or message}
    return dict(record)


def finished_record(folder: Path, record: Mapping[str, Any]) -> dict[str, Any]:
    """run.json as of now, of a run that has ended.

    It may still say `running` if whether the launcher lives cannot be known from here: on another machine.
    Raises RunFolderError if the launcher is alive.
    """
    current = current_record(record)
    launcher = current.get("launcher")
    if current.get("status") == RUNNING and isinstance(launcher, Mapping) and lives(launcher):
        raise RunFolderError(f"{folder}: the run is still in progress: expected a finished run")
    return current


@cache
def _here() -> dict[str, str]:
    def known(read: Callable[[str], str], path: str) -> str:
        try:
            return read(path)
        except OSError:
            return ""

    def content(path: str) -> str:
        return Path(path).read_text("utf-8").strip()

    return {
        "machine": f"{socket.gethostname()} {known(content, '/etc/machine-id')}".strip(),
        "boot": known(content, "/proc/sys/kernel/random/boot_id"),
        "pid_namespace": known(os.readlink, "/proc/self/ns/pid"),
    }


def stat_of(pid: int | str) -> list[str]:
    """The fields of /proc/PID/stat from the third one, the state; [] for a process that has ended, or is unknown."""
    try:
        # The name, in parentheses, may itself contain spaces and parentheses (proc(5)).
        return Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()
    except OSError:
        return []


def began(pid: int) -> str | None:
    """When a process began, in clock ticks since boot; None if there is none, or it is a zombie.

    This identifies it, since process ids are reused.
    """
    fields = stat_of(pid)
    return None if not fields or fields[0] in "ZX" else fields[19]


def processor_time_s(pid: int) -> float | None:
    """The processor time that a process has used, s, in all its threads; None if it has ended, or is unknown."""
    fields = stat_of(pid)
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") if len(fields) > 12 else None
