"""Paths of the shipped files that users read and copy.

They are next to the package in a checkout, and inside it when installed.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
ROOT = _PACKAGE / "bundled" if (_PACKAGE / "bundled").is_dir() else _PACKAGE.parent


def find(kind: str, name: str, beside: Path | None = None) -> Path | None:
    """The file `name` of a kind, in the folder `beside` or as shipped; None: neither.

    kind: "nodes", "keyexpr_maps", "scenarios" or "studies"
    """
    for folder in (beside, ROOT / kind):
        if folder is not None and (folder / name).is_file():
            return (folder / name).resolve()
    return None


def names(kind: str, beside: Path | None = None) -> list[str]:
    """All file names of a kind that `find` would find."""
    folders = [folder for folder in (beside, ROOT / kind) if folder is not None and folder.is_dir()]
    return sorted({path.name for folder in folders for path in folder.iterdir() if path.suffix in (".py", ".toml")})
