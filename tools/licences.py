"""Writes docs/ref-licences.md: the licence of every package that a lock file names, as the package states it.

python tools/licences.py      after `make lock`, with the new packages installed (make dev, make test-all, make dist)

A package that is not installed here, because it is for other systems, keeps the line that it has.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import Distribution, distributions
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "ref-licences.md"
#: Lock files, each with what it is for; a package that is in several stands under the first.
LOCKS = {
    "requirements.txt": "running",
    "requirements-sumo.txt": "SUMO",
    "requirements-dev.txt": "development, optional parts",
    "requirements-ros2.txt": "tests with ROS 2",
    "requirements-tools.txt": "lock files, releases",
    "requirements-site.txt": "the site",
}
#: Packages whose metadata state no licence: from their LICENSE files.
FROM_FILES = {"embreex": "BSD-2-Clause", "empy": "LGPL", "ros-fastcdr": "Apache-2.0", "ros-fastrtps": "Apache-2.0"}
_HEAD = """# Licences of dependencies

<!-- Written by tools/licences.py; do not edit. -->

Look up under which licence a package that mast-zenoh needs is published, as its metadata say. mast-zenoh itself is
under Apache-2.0. Of these, `pip install mast-zenoh` brings only those for running, without the tools that build it.

| package | licence | for |
|---|---|---|
"""


def canonical(name: str) -> str:
    """The name of a package as lock files and pip spell it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def locked() -> dict[str, str]:
    """All packages of the lock files, each with what it is for."""
    packages: dict[str, str] = {}
    for lock, purpose in LOCKS.items():
        for name in re.findall(r"^([\w.-]+)==", (ROOT / lock).read_text(encoding="utf-8"), flags=re.MULTILINE):
            packages.setdefault(canonical(name), purpose)
    return packages


def licence_of(distribution: Distribution) -> str:
    """The licence that a package states; "" if it states none."""
    metadata = distribution.metadata
    if expressions := metadata.get_all("License-Expression"):
        return str(expressions[0])
    stated = str((metadata.get_all("License") or [""])[0]).strip()
    if re.fullmatch(r"[A-Za-z][\w.+-]*( (OR|AND|and|or) [\w.+-]+)*", stated) and stated != "UNKNOWN":
        return stated
    classifiers = [text.split(" :: ") for text in metadata.get_all("Classifier") or ()]
    named = [parts[-1] for parts in classifiers if parts[0] == "License" and parts[-1] != "OSI Approved"]
    manifests = (file.locate() for file in distribution.files or () if file.name == "package.xml")  # of ROS
    for manifest in manifests if not named else ():
        named += re.findall(r"<license[^>]*>(.*?)</license>", Path(str(manifest)).read_text(encoding="utf-8"))
    if named:
        return ", ".join(named)
    return stated if stated and re.fullmatch(r"\w[\w .,-]{1,60}", stated) else ""


def installed() -> dict[str, str]:
    """Licences by package of this environment and those within it (tools, ROS 2, the site).

    Of a package with two versions, the one of this environment counts.
    """
    within = [str(path) for path in sorted(Path(sys.prefix).glob("*/lib/python3*/site-packages"))]
    within.append(str(Path(sys.prefix, "site")))
    licences: dict[str, str] = {}
    for distribution in distributions(path=[*sys.path, *within]):
        name = canonical(distribution.name)
        licences.setdefault(name, FROM_FILES.get(name) or licence_of(distribution))
    return licences


def written() -> dict[str, str]:
    """Licences by package as the page has them."""
    rows = PAGE.read_text(encoding="utf-8").partition("|---|\n")[2]
    return dict(re.findall(r"^\| ([\w-]+) \| ([^|]+) \| [^|]+ \|$", rows, flags=re.MULTILINE))


def page(licences: dict[str, str]) -> str:
    """The page. licences: by package"""
    purposes = list(LOCKS.values())
    ordered = sorted(locked().items(), key=lambda package: (purposes.index(package[1]), package[0]))
    return _HEAD + "".join(f"| {name} | {licences[name]} | {purpose} |\n" for name, purpose in ordered)


def main() -> int:
    """Write the page; 1 if a locked package has no known licence."""
    licences = written() | {name: licence for name, licence in installed().items() if licence}
    if unknown := locked().keys() - licences.keys():
        print(f"no licence known of: {', '.join(sorted(unknown))}; install them, or add them to FROM_FILES")
        return 1
    PAGE.write_text(page(licences), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
