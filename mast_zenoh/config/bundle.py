"""Paths of the shipped files that users read and copy.

They are next to the package in a checkout, and inside it when installed.
"""

from __future__ import annotations

from pathlib import Path

from mast_zenoh.config import plugins

_PACKAGE = Path(__file__).resolve().parents[1]
ROOT = _PACKAGE / "bundled" if (_PACKAGE / "bundled").is_dir() else _PACKAGE.parent


def find(kind: str, name: str, beside: Path | None = None) -> Path | None:
    """The file `name` of a kind, in the folder `beside`, as shipped, or of a plugin, which has nodes; None: nowhere.

    kind: "nodes", "keyexpr_maps", "scenarios" or "studies"
    """
    for folder in (beside, ROOT / kind):
        if folder is not None and (folder / name).is_file():
            return (folder / name).resolve()
    for folder in plugins.node_folders() if kind == "nodes" else ():  # found only if it is needed: it takes time
        if (folder / name).is_file():
            return (folder / name).resolve()
    return None


def names(kind: str, beside: Path | None = None) -> list[str]:
    """All shipped file names of a kind; with a folder `beside`, also those there and of plugins, as `find` has them."""
    others = () if beside is None else (beside, *(plugins.node_folders() if kind == "nodes" else ()))
    folders = [folder for folder in (ROOT / kind, *others) if folder.is_dir()]
    return sorted({path.name for folder in folders for path in folder.iterdir() if path.suffix in (".py", ".toml")})
