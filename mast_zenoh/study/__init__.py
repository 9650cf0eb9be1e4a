"""Studies: many runs, compared.

    definition  study files: validation, and expansion of grids into configurations
    comparison  every configuration once, with a run folder and a report each
    trials      many seeds, one result file per trial, resumable:
                plan (list of trials), identity (digest of a trial's inputs), trial (runs one), execution (in this
                process or on a Dask cluster), store (the study folder)
    tables      outputs of many trials: numbers (of one run), results (with increments), parameters (grid columns),
                table_file (Parquet), statistics (intervals), summary (one estimate per configuration and series)

See docs/studies.md.
"""
