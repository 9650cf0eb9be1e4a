"""The files of a search: tables, candidates, all results as JSON, and a figure."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from mast_zenoh import run_folder
from mast_zenoh.run_folder import write_bytes
from mast_zenoh.study.defences.kinds import StudyFiles
from mast_zenoh.study.search.plan import SEARCHED
from mast_zenoh.study.search.results import SearchResults
from mast_zenoh.study.search.space import as_text
from mast_zenoh.study.search.tables import candidates_csv, search_tables


def write(folder: Path, results: SearchResults) -> StudyFiles:
    """Write search.md, search.csv, candidates.csv, search.json and the figure into the study's folder."""
    from mast_zenoh.study.search.figure import search_figure  # drawing libraries are slow to load

    tables, figure = search_tables(results), search_figure(results)
    texts = {
        "search.md": tables.as_markdown(),
        "search.csv": tables.as_csv(),
        "candidates.csv": candidates_csv(results),
    }
    for name, text in texts.items():
        write_bytes(folder / name, text.encode())
    run_folder.write_json(folder / "search.json", run_folder.finite(as_json(results)))
    figure.save(folder)
    return StudyFiles(tables, {figure.name: figure}, [*texts, "search.json", *figure.names], on_page=False)


def as_json(results: SearchResults) -> dict[str, Any]:
    """All results as plain values; numbers that are not known are NaN."""
    study, plan, best = results.study, results.plan, results.candidates.best_trial
    optimism, over_baseline = results.optimism
    return {
        "name": study.name,
        "objective": plan.objective.text,
        "direction": "maximise" if plan.maximise else "minimise",
        "sampler": results.sampler,
        "parameters": {name: as_text(each) for name, each in plan.space.items()},
        "scenes": [scene.label for scene in study.scenes],
        "frames": study.frames,
        "search_seeds": list(results.search_seeds),
        "held_out_seeds": list(results.held_out_seeds),
        "baseline": study.baseline,
        "default": {"configuration": plan.run, "values": dict(results.defaults)},
        "searched": {
            "configuration": SEARCHED,
            "candidate": best.number + 1,
            "values": best.params,
            "optimism": optimism,
            "optimism_over_baseline": over_baseline,
        },
        "results": [asdict(row) for row in results.rows.values()],
        "candidates": [
            {"candidate": number + 1, "batch": number // plan.batch + 1, "values": each.params, "value": value}
            for number, (each, value) in enumerate(zip(results.candidates.trials, results.values, strict=True))
        ],
    }
