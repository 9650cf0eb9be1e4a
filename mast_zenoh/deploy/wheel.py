"""Wheels for other hosts: this package, and the dependencies installed here."""

from __future__ import annotations

import base64
import hashlib
import os
import platform
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, distribution, requires, version
from importlib.util import find_spec
from pathlib import Path

from mast_zenoh.config import bundle, plugins
from mast_zenoh.errors import EngineError
from mast_zenoh.version import __version__

REQUIREMENTS = "node-requirements.txt"
_PACKAGE = Path(__file__).resolve().parents[1]
_KINDS = ("nodes", "keyexpr_maps", "scenarios", "studies", "deploy")
#: Compiled kernels are included with their sources; an interpreter that they do not fit ignores them.
_SUFFIXES = (".py", ".j2", ".js", ".css", ".html", ".toml", ".txt", ".yml", ".json", ".pyx", ".pxd", ".so")
_WHEEL = "Wheel-Version: 1.0\nGenerator: mast-zenoh\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
_OLDEST = (1980, 1, 1, 0, 0, 0)  # earliest time in a zip file: equal content gives equal bytes


def build(folder: Path) -> Path:
    """Build a wheel of a checkout or installation in a folder, without a build tool."""
    return _written(folder, f"mast_zenoh-{__version__}", _content(), _metadata())


def build_plugins(folder: Path) -> list[Path]:
    """Build a wheel of each installed distribution with plugins; their own requirements are not among them."""
    packages: dict[str, set[str]] = {}
    for plugin in plugins.installed():
        packages.setdefault(plugin.distribution.partition(" ")[0], set()).add(plugin.package)
    return [_plugin_wheel(folder, name, tops) for name, tops in packages.items()]


def _plugin_wheel(folder: Path, name: str, packages: set[str]) -> Path:
    """A wheel of the packages of an installed distribution, also if its sources are elsewhere."""
    content: list[tuple[str, Path]] = []
    for package in sorted(packages):
        spec = find_spec(package)
        for root in spec.submodule_search_locations or () if spec else ():
            files = [path for path in Path(root).rglob("*") if path.is_file() and path.suffix != ".pyc"]
            content += [(f"{package}/{path.relative_to(root).as_posix()}", path) for path in files]
        if spec and spec.origin and not spec.submodule_search_locations:
            content.append((f"{package}.py", Path(spec.origin)))
    installed = distribution(name)
    metadata = {file: installed.read_text(file) or "" for file in ("METADATA", "entry_points.txt")}
    return _written(folder, f"{re.sub('[-_.]+', '_', name)}-{installed.version}", content, metadata | {"WHEEL": _WHEEL})


def _written(folder: Path, name: str, content: Iterable[tuple[str, Path]], metadata: Mapping[str, str]) -> Path:
    """Write a wheel. content: places in it, and files;  metadata: the dist-info files except RECORD"""
    target = folder / f"{name}-py3-none-any.whl"
    records = []
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:

        def add(path: str, content: bytes) -> None:
            entry = zipfile.ZipInfo(path, _OLDEST)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content, zipfile.ZIP_DEFLATED)
            digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
            records.append(f"{path},sha256={digest},{len(content)}")

        for path, file in sorted(content):
            add(path, file.read_bytes())
        for path, text in metadata.items():
            add(f"{name}.dist-info/{path}", text.encode())
        records.append(f"{name}.dist-info/RECORD,,")
        archive.writestr(zipfile.ZipInfo(f"{name}.dist-info/RECORD", _OLDEST), "\n".join(records) + "\n")
    return target


def requirements() -> list[str]:
    """The packages that a node needs, each as `name==version` as installed here."""
    lines = (bundle.ROOT / "deploy" / REQUIREMENTS).read_text(encoding="utf-8").splitlines()
    try:
        return [f"{line}=={version(line)}" for line in lines if line and not line.startswith("#")]
    except PackageNotFoundError as error:
        raise EngineError(f"{error.name} is not installed here: run `pip install mast-zenoh`") from None


def launcher_requirements() -> list[str]:
    """The packages that a launcher needs besides those of a node, `name==version`."""
    node = {wanted.partition("==")[0] for wanted in requirements()}
    found: dict[str, str] = {}
    pending = ["mast-zenoh"]
    while pending:
        for line in requires(pending.pop()) or ():
            name = re.split(r"[^\w.-]", line, maxsplit=1)[0].lower().replace("_", "-")
            if "extra ==" in line or name in found:
                continue
            try:
                found[name] = version(name)
            except PackageNotFoundError:
                continue  # only for other systems or versions of Python
            pending.append(name)
    return [f"{name}=={release}" for name, release in sorted(found.items()) if name not in node]


def third_party(folder: Path, python: str = "", machine: str = "", required: Sequence[str] | None = None) -> list[Path]:
    """The wheels of packages in a folder; missing ones are downloaded.

    python: version on the target host, "3.12"; machine: its processor, as from `uname -m`; empty: as here
    required: `name==version`; None: those of a node

    Raises EngineError if they cannot be downloaded.
    """
    required = requirements() if required is None else required
    folder.mkdir(parents=True, exist_ok=True)
    missing = [wanted for wanted in required if not _wheels_of(folder, wanted)]
    if missing:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
        command += ["--only-binary=:all:", "--dest", str(folder), *_platform_options(python, machine), *missing]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            broken = [line for line in lines if "connection broken by" in line]  # before "No matching distribution"
            reason = "; ".join([*broken[-1:], lines[-1]])
            raise EngineError(f"wheels cannot be downloaded: {reason}; put them into {folder}")
    return [wheel for wanted in required for wheel in _wheels_of(folder, wanted)[:1]]


def cache(python: str = "", machine: str = "") -> Path:
    """The cache folder of wheels, by Python version and processor."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return home / "mast-zenoh" / "wheels" / f"{python or _python_version()}-{machine or platform.machine()}"


def _wheels_of(folder: Path, wanted: str) -> list[Path]:
    name, _, release = wanted.partition("==")
    name = re.sub("[-_.]+", "_", name).lower()
    return sorted(path for path in folder.glob(f"*-{release}-*.whl") if path.name.lower().startswith(f"{name}-"))


def _python_version() -> str:
    return f"{sys.version_info.major}.{sys.version_info.minor}"


def _platform_options(python: str, machine: str) -> Iterator[str]:
    """pip's options for wheels of another interpreter or processor than this one."""
    python, machine = python or _python_version(), machine or platform.machine()
    if (python, machine) == (_python_version(), platform.machine()):
        return
    tag = f"cp{python.replace('.', '')}"
    yield from ("--python-version", python, "--implementation", "cp", "--abi", tag, "--abi", "abi3", "--abi", "none")
    for glibc in range(36, 16, -1):
        yield from ("--platform", f"manylinux_2_{glibc}_{machine}")
    yield from ("--platform", f"manylinux2014_{machine}")


def _content() -> Iterator[tuple[str, Path]]:
    for path in _PACKAGE.rglob("*"):
        name = path.relative_to(_PACKAGE)
        if path.is_file() and name.parts[0] != "bundled" and path.suffix in _SUFFIXES:
            yield f"mast_zenoh/{name.as_posix()}", path
    for kind in _KINDS:
        for path in (bundle.ROOT / kind).rglob("*"):
            if path.is_file() and (path.suffix in _SUFFIXES or path.name == "Dockerfile"):
                yield f"mast_zenoh/bundled/{path.relative_to(bundle.ROOT).as_posix()}", path


def _metadata() -> dict[str, str]:
    """The dist-info files except RECORD, from pyproject.toml or else the installation."""
    project = bundle.ROOT / "pyproject.toml"
    if not project.is_file():
        installed = distribution("mast-zenoh")
        texts = {name: installed.read_text(name) or "" for name in ("METADATA", "entry_points.txt")}
        return texts | {"WHEEL": _WHEEL}
    project_table = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
    lines = ["Metadata-Version: 2.1", f"Name: {project_table['name']}", f"Version: {project_table['version']}"]
    lines += [
        f"Requires-Python: {project_table['requires-python']}",
        *(f"Requires-Dist: {requirement}" for requirement in project_table["dependencies"]),
    ]
    scripts = "".join(f"{name} = {target}\n" for name, target in project_table["scripts"].items())
    return {"METADATA": "\n".join(lines) + "\n", "entry_points.txt": f"[console_scripts]\n{scripts}", "WHEEL": _WHEEL}
