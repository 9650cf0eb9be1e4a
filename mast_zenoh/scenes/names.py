"""Short names of scenes: `intersection`, `av2:PATH` and so on."""

from __future__ import annotations

from typing import Any

from mast_zenoh.errors import ConfigurationError, nearest

#: Scene types by short name; the text after the colon is their path.
_WITH_PATH = {
    "recording": "RecordingFile",
    "avstack": "AVstackScene",
    "av2": "AV2Log",
    "kitti": "KittiTracking",
    "commonroad": "CommonRoadScenario",
    "sumo": "SumoTrace",
    "opv2v": "OPV2VScene",
    "v2xreal": "V2XRealScene",
    "multiv2x": "MultiV2XScene",
    "v2v4real": "V2V4RealScene",
    "dair": "DAIRScene",
    "rcooper": "RCooperScene",
    "tumtraf": "TUMTrafV2X",
    "urbaning": "UrbanIngV2X",
}
#: All names before the colon.
SHORT_NAMES = ("intersection", *_WITH_PATH)
_KNOWN = ("intersection", "intersection:INDEX", *(f"{name}:PATH" for name in _WITH_PATH))


def parse_scene(text: str) -> dict[str, Any]:
    """The configuration of a scene from its short name.

    `intersection` and `intersection:INDEX` (a generated junction), or a name of `_WITH_PATH`, a colon and a path.
    Raises ConfigurationError, listing the known names, for anything else.
    """
    name, colon, argument = text.partition(":")
    if name == "intersection" and not colon:
        return {"type": "Intersection"}
    if name == "intersection" and argument.isdecimal():
        return {"type": "Intersection", "scene_index": int(argument)}
    if name in _WITH_PATH and argument:
        return {"type": _WITH_PATH[name], "path": argument}
    if name in _WITH_PATH:
        raise ConfigurationError(f"scene {text!r}: no path, expected {name}:PATH")
    if name == "intersection":
        raise ConfigurationError(
            f"scene {text!r}: {argument!r} is not an index, expected intersection:INDEX, 0 or more"
        )
    hint = nearest(name, ("intersection", *_WITH_PATH))
    raise ConfigurationError(f"scene {text!r}: unknown name {name!r}{hint} (known: {', '.join(_KNOWN)})")
