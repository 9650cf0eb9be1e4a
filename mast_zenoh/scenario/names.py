"""Names of runs and studies: a part of folders' names and of every key expression of a run."""

from __future__ import annotations

import re

from mast_zenoh.errors import ConfigurationError

_MAX = 100
#: Separators of paths, what has a meaning in key expressions, control characters, and bytes that are no text.
_REFUSED = re.compile(r"[/\\*#?$\x00-\x1f\x7f\ud800-\udfff]")


def checked_name(name: object, place: str) -> str:
    """A name as it was given; raises ConfigurationError for one that would leave its folder or its key."""
    if not isinstance(name, str) or not 0 < len(name) <= _MAX or _REFUSED.search(name) or name[0] in ".@-":
        raise ConfigurationError(
            f"{place}: found {name!r:.120}, expected at most {_MAX} characters, none of / \\ * # ? $, "
            "and no . @ or - at the beginning"
        )
    return name


def name_of_file(stem: str) -> str:
    """The name of what has none, made of its file's."""
    return _REFUSED.sub("_", stem).lstrip(".@-")[:_MAX] or "unnamed"
