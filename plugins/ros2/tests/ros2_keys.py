"""Reads the key expressions that `mast_ros2.liveliness_tokens` writes."""

import re

from mast_ros2.liveliness_tokens import NO_HASH, DataKey, type_of_dds

from mast_zenoh.errors import MessageError


def parse_data_key(key: str) -> DataKey:
    """The topic and type of a key expression; raises MessageError if it is none of rmw_zenoh's."""
    chunks = key.split("/")
    if len(chunks) < 4:
        raise MessageError(f"key {key!r:.200}: found {len(chunks)} chunks, expected domain/topic/type/hash")
    domain, *topic, dds_name, type_hash = chunks
    if not re.fullmatch("0|[1-9][0-9]{0,18}", domain):
        raise MessageError(f"key {key!r:.200}: found {domain!r}, expected a whole number")
    known_hash = None if type_hash == NO_HASH else type_hash
    try:
        return DataKey(int(domain), "/" + "/".join(topic), type_of_dds(dds_name), known_hash)
    except (MessageError, ValueError) as error:
        raise MessageError(f"key {key!r:.200}: {error}") from None
