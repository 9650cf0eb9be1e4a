"""Writes the tables and figures of a matrix of defences into the folder of its study."""

from __future__ import annotations

from pathlib import Path

from mast_zenoh.report.defence_rows import DefenceMatrix
from mast_zenoh.report.figures.drawing import RenderedFigure


def write(folder: Path, matrix: DefenceMatrix) -> tuple[dict[str, RenderedFigure], list[str]]:
    """Write tables and figures; returns the figures by name, and the names of all files."""
    from mast_zenoh.report.figures.defences import figures_of_defences  # drawing libraries are slow to load
    from mast_zenoh.report.tables import defences as tables

    texts = {
        "defences.md": tables.as_markdown(matrix),
        "defences.csv": tables.as_csv(matrix),
        "defences.tex": tables.as_latex(matrix),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    figures = figures_of_defences(matrix)
    for figure in figures.values():
        figure.save(folder)
    return figures, [*texts, *(f"{name}.png" for name in figures)]
