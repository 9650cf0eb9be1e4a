"""Pictures that are not painted, as painting takes most of a page's time."""

import pytest


def leave_unpainted(patch: pytest.MonkeyPatch) -> None:
    """Figures of pages and files are one pixel."""
    pixel = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + 2 * (1).to_bytes(4)
    for kind in ("png", "svg", "pdf"):
        patch.setattr(f"mast_zenoh.show.figures.drawing.{kind}", lambda figure: pixel)
