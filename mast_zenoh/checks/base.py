"""The outcome of a check."""

from __future__ import annotations

from typing import Any, NamedTuple


class Check(NamedTuple):
    """The outcome of a check.

    name:   name of the check
    ok:     False: the check failed
    detail: a sentence: the findings, or why nothing was checked
    values: measured values, plain
    """

    name: str
    ok: bool
    detail: str
    values: dict[str, Any]

    @classmethod
    def skipped(cls, name: str, reason: str) -> Check:
        """The outcome if there was nothing to check."""
        return cls(name, True, f"not checked: {reason}", {"checked": False})
