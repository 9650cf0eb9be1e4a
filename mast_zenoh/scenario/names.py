"""Names of runs and studies, used in folder names and key expressions."""

from __future__ import annotations

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.run_files import MAX_NAME, REFUSED, is_name


def checked_name(name: object, place: str) -> str:
    """Return a name; raises ConfigurationError if it could escape its folder or key."""
    if not isinstance(name, str) or not is_name(name) or name[0] in "@-":
        raise ConfigurationError(
            f"{place}: found {name!r:.120}, expected at most {MAX_NAME} characters, none of / \\ * # ? $, "
            "and no . @ or - at the beginning"
        )
    return name


def name_of_file(stem: str) -> str:
    """A valid name made from a file's stem, for a scenario or study without one."""
    return REFUSED.sub("_", stem).lstrip(".@-")[:MAX_NAME] or "unnamed"
