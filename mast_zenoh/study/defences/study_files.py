"""The files that a study of defences writes into its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mast_zenoh.run_files import write_bytes

if TYPE_CHECKING:
    from mast_zenoh.report.figures.drawing import RenderedFigure


@dataclass(frozen=True, slots=True)
class StudyFiles:
    """What a study of defences wrote: figures for the page, names of all files, and the tables for the terminal."""

    figures: Mapping[str, RenderedFigure]
    names: Sequence[str]
    as_rich: Callable[[], Any]


def write_files(
    folder: Path, texts: Mapping[str, str], figures: Mapping[str, RenderedFigure], as_rich: Callable[[], Any]
) -> StudyFiles:
    """Write texts by file name, and figures; as_rich: makes the tables for the terminal."""
    for name, text in texts.items():
        write_bytes(folder / name, text.encode())
    for figure in figures.values():
        figure.save(folder)
    return StudyFiles(figures, [*texts, *(name for figure in figures.values() for name in figure.names)], as_rich)
