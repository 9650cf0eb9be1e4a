"""Recognises the type of a scene by the files in its folder."""

from __future__ import annotations

from pathlib import Path

from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes.names import SHORT_NAMES

#: Patterns of files, by short name: a folder with a file of each pattern of a tuple is of this type.
_FILES: dict[str, tuple[tuple[str, ...], ...]] = {
    "avstack": (("objects/objectstate-*.txt",), ("*/objects/objectstate-*.txt",)),
    "av2": (("city_SE3_egovehicle.feather",), ("*/city_SE3_egovehicle.feather",)),
}
_ARCHIVES = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")


def recognised(scene: str) -> str:
    """A scene's short name, such as av2:PATH, from a short name, a file or a folder.

    Raises ConfigurationError for a name that is neither, and SceneError for a folder whose files are of no known type,
    or of several.
    """
    name, colon, _ = scene.partition(":")
    path = Path(scene)
    if name in SHORT_NAMES and (colon or not path.exists()):
        return scene
    if not path.exists():
        known = ", ".join(SHORT_NAMES)
        raise ConfigurationError(f"scene {scene!r}: no such file or folder, and no short name (known: {known})")
    if path.suffix == ".npz":
        return f"recording:{path}"
    if path.is_file():
        if path.name.endswith(_ARCHIVES):
            return f"avstack:{path}"
        raise SceneError(f"{path}: found a file, expected a folder, an .npz file or a tar archive")
    matching = [
        known
        for known, variants in _FILES.items()
        if any(all(any(path.glob(pattern)) for pattern in variant) for variant in variants)
    ]
    if len(matching) != 1:
        found = ", ".join(sorted(entry.name for entry in path.iterdir())[:8]) or "nothing"
        kinds = f"files of {' and of '.join(matching)}" if matching else "no files of a known type"
        raise SceneError(f"{path}: {kinds} in this folder; found {found}; expected one of {', '.join(_FILES)}")
    return f"{matching[0]}:{path}"
