"""Checks what this machine can do; each check reports a finding and a fix."""

from __future__ import annotations

import contextlib
import os
import platform
import pwd
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import NamedTuple

from mast_zenoh import kernels
from mast_zenoh import version as release
from mast_zenoh.config import plugins
from mast_zenoh.deploy import docker as engine
from mast_zenoh.deploy.compose import command
from mast_zenoh.errors import BackendError, EngineError
from mast_zenoh.launch.netns import namespaces
from mast_zenoh.mesh.security import explain
from mast_zenoh.mesh.session import open_router


class Diagnosis(NamedTuple):
    """The result of a check.

    ok: None for an optional part that is missing; fix: what to do, if anything
    """

    name: str
    ok: bool | None
    detail: str
    fix: str = ""


def examine(credentials: Path | None = None, endpoint: str | None = None) -> Iterator[Diagnosis]:
    """Run all checks, and check a folder of credentials if one is named."""
    for check in CHECKS:
        yield check()
    if credentials is not None:
        reasons = explain(credentials, endpoint)
        where = f"{credentials}{f' at {endpoint}' if endpoint else ''}"
        yield Diagnosis("certificates", not reasons, "; ".join(reasons) or f"{where}: valid")


def report(findings: Iterable[Diagnosis]) -> str:
    """What a bug report needs, as one text without personal data.

    findings: those of `examine`
    """
    facts = [Diagnosis("system", True, _system()), Diagnosis("packages", True, _packages())]
    symbols = {True: "ok", False: "no", None: "--"}
    return "\n".join(
        f"{symbols[finding.ok]} {finding.name:<10} {without_personal_data(finding.detail)}"
        for finding in (*findings, *facts)
    )


#: Absolute paths, also the part of a URL after its scheme; addresses of IPv4 and IPv6.
_PATH = re.compile(r"(?<!\w)/[^\s'\",;)]*")
_ADDRESS = re.compile(r"(?<![\w.])\d{1,3}(?:\.\d{1,3}){3}(?![\w.])|(?<![\w:])[0-9a-fA-F]*:[0-9a-fA-F]*:[0-9a-fA-F:.]*")
#: Between scheme, user, password, host and port of a URL: messages name some of them alone.
_URL_PARTS = re.compile(r"://|[@:/]")
#: The name of a Docker context, from the user's own files.
_CONTEXT = re.compile(r"(context \")[^\"]+")
#: Shorter values of variables, such as "1" and "C", tell nothing.
_SHORTEST_VALUE = 4


def without_personal_data(text: str) -> str:
    """A text without values of variables, names of the user and the host, paths, and addresses."""
    values = {name: value for name, value in os.environ.items() if len(value) >= _SHORTEST_VALUE}
    personal = {
        part: f"${name}" for name, value in values.items() for part in _URL_PARTS.split(value) if "://" in value
    }
    personal |= {value: f"${name}" for name, value in values.items()}
    personal |= {os.getcwd(): "<path>", os.path.expanduser("~"): "<path>"}
    host = platform.node()
    personal |= {host: "<host>", host.partition(".")[0]: "<host>"}
    with contextlib.suppress(KeyError):  # the user has no name
        personal[pwd.getpwuid(os.getuid()).pw_name] = "<user>"
    longest_first = sorted(filter(None, personal), key=len, reverse=True)
    words = re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, longest_first))})(?!\w)")
    text = words.sub(lambda match: personal[match[0]], text)
    return _CONTEXT.sub(r"\1<name>", _ADDRESS.sub("<address>", _PATH.sub("<path>", text)))


def _system() -> str:
    """The operating system, processors that this process may use, and memory."""
    try:
        name = platform.freedesktop_os_release()["PRETTY_NAME"]
    except OSError:
        name = "unknown distribution"
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    processors = f"{len(os.sched_getaffinity(0))} of {os.cpu_count()} processors"
    kernel = f"{platform.system()} {platform.release()} {platform.machine()}"
    return f"{name}, {kernel}, {processors}, {memory >> 30} GiB of memory"


def _packages() -> str:
    """Versions of the packages that this one needs, then the optional ones that are missing."""
    found, missing = [], []
    lines = [line for line in requires("mast-zenoh") or () if not re.search(r"extra == .dev\b", line)]
    for name in sorted({re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in lines}):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    return f"{', '.join(found)}; not installed: {', '.join(missing) or 'none'}"


def python() -> Diagnosis:
    """The versions of Python and of this package."""
    detail = f"{platform.python_version()}, mast-zenoh {release.version_string()}"
    return Diagnosis("python", sys.version_info >= (3, 11), detail)


def compiled_kernels() -> Diagnosis:
    """Whether compiled kernels are in use."""
    reason = kernels.why_not()
    if reason:
        detail = f"not used: NumPy is slower, and wires cannot have a codec (cpm, cam): {reason}"
        return Diagnosis("kernels", None, detail, kernels.remedy())
    return Diagnosis("kernels", True, "compiled")


def installed_plugins() -> Diagnosis:
    """The installed plugins, and those that are left out."""
    problems = [f"{plugin.distribution} {problem}" for plugin, problem in plugins.load().problems.items()]
    usable = [plugin.distribution for plugin in plugins.load().plugins]
    detail = "; ".join([", ".join(usable) or "none usable", *problems])
    missing = [plugins.command_for(project) for project in plugins.OUR_PLUGINS if not plugins.is_installed(project)]
    fix = "repair or uninstall them" if problems else " && ".join(missing)
    return Diagnosis("plugins", None if problems or not usable else True, detail, fix)


def mesh() -> Diagnosis:
    """Whether a router comes up on the loopback interface."""
    try:
        session, endpoint = open_router()
    except Exception as error:
        return Diagnosis("zenoh", False, str(error), "reinstall eclipse-zenoh")
    session.close()  # type: ignore[no-untyped-call]
    return Diagnosis("zenoh", True, f"{version('eclipse-zenoh')}, a router came up at {endpoint}")


def control() -> Diagnosis:
    """Whether runs obey control messages without a signature: all that are not started with `--secure`."""
    return Diagnosis("security", None, "runs obey control messages without a signature", "mast run … --secure")


def optional(name: str, look: Callable[[], str], fix: str) -> Diagnosis:
    """Whether an optional part is usable, as `look` describes it."""
    try:
        return Diagnosis(name, True, look())
    except (EngineError, BackendError) as error:
        return Diagnosis(name, None, str(error), fix)


def _compose() -> str:
    words = command()
    return f"{' '.join(words)} {engine.run([*words, 'version', '--short'], timeout=30.0).strip()}"


def _image() -> str:
    engine.check_image()
    return engine.TAG


def _ssh() -> str:
    try:
        return f"asyncssh {version('asyncssh')}"
    except ModuleNotFoundError:
        raise EngineError("asyncssh is not installed") from None


def _namespaces() -> str:
    wanted = {need: ["hosts"] for need in ("partition", "loss", "bandwidth", "delay")}
    return f"yes, delays by {namespaces.delays_by(wanted)}"


def disk_space() -> Diagnosis:
    """The free disk space here."""
    free = shutil.disk_usage(Path.cwd()).free
    enough = free > 1 << 28
    return Diagnosis("disk", enough, f"{free >> 30} GiB free in {Path.cwd()}", "" if enough else "make room")


CHECKS: list[Callable[[], Diagnosis]] = [
    python,
    compiled_kernels,
    installed_plugins,
    mesh,
    control,
    lambda: optional("docker", lambda: f"engine {engine.check()}", "apt install docker.io; usermod -aG docker $USER"),
    lambda: optional("compose", _compose, "apt install docker-compose"),
    lambda: optional("image", _image, "mast deploy image"),
    lambda: optional("ssh", _ssh, "pip install 'mast-zenoh[deploy]'"),
    lambda: optional("namespaces", _namespaces, "see docs/how-to-hosts.md#real-networks-on-one-machine"),
    disk_space,
]
