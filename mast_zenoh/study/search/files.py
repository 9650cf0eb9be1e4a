"""The files of a search: tables, candidates, all results as JSON, and a figure."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from mast_zenoh import run_folder
from mast_zenoh.metrics.search_results import SearchResults, SearchRow
from mast_zenoh.run_folder import write_bytes
from mast_zenoh.study.defences.kinds import StudyFiles

NAME = "search"


def write(folder: Path, results: SearchResults) -> StudyFiles:
    """Write search.md, search.csv, candidates.csv, search.json and the figure into the study's folder."""
    from mast_zenoh.report.figures.search import search_figure  # drawing libraries are slow to load
    from mast_zenoh.report.tables import search as search_tables

    tables = search_tables.search_tables(results)
    texts = {
        f"{NAME}.md": tables.as_markdown(),
        f"{NAME}.csv": tables.as_csv(),
        "candidates.csv": search_tables.candidates_csv(results),
    }
    for name, text in texts.items():
        write_bytes(folder / name, text.encode())
    run_folder.write_json(folder / f"{NAME}.json", run_folder.finite(as_json(results)))
    figure = search_figure(results)
    figure.save(folder)
    return StudyFiles({NAME: figure}, [*texts, f"{NAME}.json", *figure.names], tables.as_rich)


def as_json(results: SearchResults) -> dict[str, Any]:
    """All results as plain values; numbers that are not known are NaN."""
    return {
        "name": results.name,
        "objective": results.objective,
        "direction": "maximise" if results.maximise else "minimise",
        "sampler": results.sampler,
        "parameters": dict(results.space),
        "scenes": results.scenes,
        "frames": results.frames,
        "search_seeds": results.search_seeds,
        "held_out_seeds": results.held_out_seeds,
        "baseline": results.baseline,
        "default": {"configuration": results.default, "values": dict(results.defaults)},
        "searched": {
            "configuration": results.searched,
            "candidate": results.best + 1,
            "values": dict(results.found.values),
            "optimism": results.optimism,
            "optimism_over_baseline": results.optimism_over_baseline,
        },
        "results": [_row(row) for row in results.rows.values()],
        "candidates": [
            {"candidate": each.number + 1, "batch": each.batch + 1, "values": dict(each.values), "value": each.value}
            for each in results.candidates
        ],
    }


def _row(row: SearchRow) -> dict[str, Any]:
    return {"configuration": row.label, "search": row.search} | {
        name: asdict(getattr(row, name)) for name in ("held_out", "over_baseline", "over_default")
    }
