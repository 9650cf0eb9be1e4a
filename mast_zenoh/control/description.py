"""Description of a running run, which the launcher sends to an observer that has no access to the run folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import msgpack

from mast_zenoh.control import fields
from mast_zenoh.errors import MessageError

#: Most bytes of an answer, with the scene.
MAX_DESCRIPTION_BYTES = 256 << 20

#: Key below the run's prefix, and the request for a description without the scene.
DESCRIBE, WITHOUT_SCENE = "@description", b"without scene"


class Description(NamedTuple):
    """A running run.

    run: its id;  scenario: scenario.json;  wiring: the current one, as in wiring.json
    scene: content of scene.npz; empty: there is none, or it was not asked for
    """

    run: str
    scenario: dict[str, Any]
    wiring: dict[str, Any]
    scene: bytes


def encode_description(run: str, scenario: Mapping[str, Any], wiring: Mapping[str, Any], scene: bytes) -> bytes:
    """Encode a description."""
    packed: bytes = msgpack.packb({"run": run, "scenario": json.dumps(scenario), "wiring": wiring, "scene": scene})
    return packed


def decode_description(payload: bytes) -> Description:
    """Decode a description; raises MessageError.

    Scenario and wiring are objects of any content: their users check them.
    """
    what = DESCRIBE
    if len(payload) > MAX_DESCRIPTION_BYTES:
        raise MessageError(f"{what}: {len(payload)} bytes, expected at most {MAX_DESCRIPTION_BYTES}")
    content = fields.fields(
        fields.unpack(payload, what, MAX_DESCRIPTION_BYTES), ("run", "scenario", "wiring", "scene"), what
    )
    try:
        scenario = json.loads(fields.text(content["scenario"], f"{what}: scenario", MAX_DESCRIPTION_BYTES))
    except (ValueError, RecursionError) as error:
        raise MessageError(f"{what}: scenario: not JSON: {str(error)[:100]}") from None
    if not isinstance(content["scene"], bytes):
        raise MessageError(f"{what}: scene: found {fields.abbreviated(content['scene'])}, expected bytes")
    return Description(
        fields.name(content["run"], f"{what}: run"),
        fields.mapping(scenario, f"{what}: scenario"),
        fields.mapping(content["wiring"], f"{what}: wiring"),
        content["scene"],
    )
