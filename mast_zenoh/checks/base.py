"""What a check says."""

from __future__ import annotations

from typing import Any, NamedTuple


class Check(NamedTuple):
    """The outcome of a check.

    name:   which one
    ok:     False: what was checked does not hold
    detail: in a sentence: what was found, or why nothing was checked
    values: figures, plain values
    """

    name: str
    ok: bool
    detail: str
    values: dict[str, Any]

    @classmethod
    def skipped(cls, name: str, reason: str) -> Check:
        """There was nothing to check."""
        return cls(name, True, f"not checked: {reason}", {"checked": False})
