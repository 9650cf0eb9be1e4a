"""Names of runs and studies, used in folder names and key expressions."""

from __future__ import annotations

import re

from mast_zenoh.errors import ConfigurationError

_MAX = 100
#: Path separators, special characters of key expressions, control characters, and surrogates (bytes that are not text).
_REFUSED = re.compile(r"[/\\*#?$\x00-\x1f\x7f\ud800-\udfff]")


def checked_name(name: object, place: str) -> str:
    """Return a name; raises ConfigurationError if it could escape its folder or key."""
    if not isinstance(name, str) or not 0 < len(name) <= _MAX or _REFUSED.search(name) or name[0] in ".@-":
        raise ConfigurationError(
            f"{place}: found {name!r:.120}, expected at most {_MAX} characters, none of / \\ * # ? $, "
            "and no . @ or - at the beginning"
        )
    return name


def name_of_file(stem: str) -> str:
    """A valid name made from a file's stem, for a scenario or study without one."""
    return _REFUSED.sub("_", stem).lstrip(".@-")[:_MAX] or "unnamed"
