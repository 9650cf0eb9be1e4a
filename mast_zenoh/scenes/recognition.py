"""Recognises the type of a scene by the files in its folder."""

from __future__ import annotations

from pathlib import Path

from mast_zenoh.errors import ConfigurationError, SceneError, nearest
from mast_zenoh.scenes.files.bounded_file import read_pieces
from mast_zenoh.scenes.names import SHORT_NAMES

#: By short name, variants of the files in a folder of this type: all patterns match, but none that begins with "!".
_FILES: dict[str, tuple[tuple[str, ...], ...]] = {
    "avstack": (("objects/objectstate-*.txt",), ("*/objects/objectstate-*.txt",)),
    "av2": (("city_SE3_egovehicle.feather",), ("*/city_SE3_egovehicle.feather",)),
    "kitti": (("label_02/*.txt", "oxts/*.txt"),),
    "sumo": (("*fcd*.xml*",), ("*fcd*.csv*",)),
    "opv2v": (("data_protocol.yaml", "*/*.yaml", "!map/*.yaml"),),
    "v2xreal": (("-[0-9]*/*.yaml", "!data_protocol.yaml"),),
    "multiv2x": (("map/*.yaml",),),
    "v2v4real": (("0/*.yaml", "1/*.yaml", "!data_protocol.yaml", "!-[0-9]*/*.yaml"),),
    "dair": (("cooperative/data_info.json",),),
    "rcooper": (("calib/lidar2world/*.json",),),
    "tumtraf": (("labels_point_clouds/*/*.json",),),
    "urbaning": (("labels_av_track_ids.json",), ("timesync_info.csv", "calibration.json")),
}
_ARCHIVES = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tar.xz")
#: The first element of XML files, by short name.
_ROOTS = {b"<commonRoad": "commonroad", b"<fcd-export": "sumo"}


def recognised(scene: str) -> str:
    """A scene's short name, such as av2:PATH, from a short name, a file or a folder.

    Raises ConfigurationError for a name that is neither, and SceneError for a file or folder of no known type, or of
    several.
    """
    name, colon, _ = scene.partition(":")
    path = Path(scene)
    if name in SHORT_NAMES and (colon or not path.exists()):
        return scene
    if not path.exists():
        raise ConfigurationError(
            f"scene {scene!r}: no such file or folder, and no short name{nearest(name, SHORT_NAMES)}"
        )
    kinds = _kinds_of_folder(path) if path.is_dir() else _kinds_of_file(path)
    if len(kinds) > 1:
        raise SceneError(f"{path}: found files of {' and of '.join(kinds)}; name one of them, {kinds[0]}:{path}")
    if not kinds:
        entries = sorted(entry.name for entry in path.iterdir())[:8] if path.is_dir() else [path.name]
        found = ", ".join(entries) or "nothing"
        raise SceneError(f"{path}: found {found}; expected the files of one of {', '.join(SHORT_NAMES[1:])}")
    return f"{kinds[0]}:{path}"


def _kinds_of_folder(path: Path) -> list[str]:
    def matches(pattern: str) -> bool:
        return any(path.glob(pattern.removeprefix("!"))) != pattern.startswith("!")

    return [kind for kind, variants in _FILES.items() if any(all(map(matches, variant)) for variant in variants)]


def _kinds_of_file(path: Path) -> list[str]:
    if path.suffix == ".npz":
        return ["recording"]
    if path.name.endswith(_ARCHIVES):
        return ["avstack"]
    if ".xml" in path.suffixes:
        start = next(read_pieces(path), b"")
        return [kind for root, kind in _ROOTS.items() if root in start]
    return []
