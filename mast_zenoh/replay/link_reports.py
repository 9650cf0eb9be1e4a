"""Reports of links, without what they did on wires that a replay leaves out."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from mast_zenoh.errors import MessageError
from mast_zenoh.links import WIRES
from mast_zenoh.messages import codec
from mast_zenoh.messages.schemas import Message


def restricted(payload: bytes, wires: Collection[str]) -> bytes:
    """A link report with the rows about some wires alone; unchanged if it has no others, or is malformed.

    wires: by message type
    """
    try:
        header, body = codec.decode(payload, "link_report")
    except MessageError:
        return payload
    kept = np.isin(body["port"], [index for index, message in enumerate(WIRES) if message in wires])
    if kept.all():
        return payload
    return codec.encode(Message(header, {name: column[kept] for name, column in body.items()}))
