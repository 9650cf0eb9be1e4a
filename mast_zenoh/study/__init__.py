"""Studies: many runs, compared.

    definition  study files, checked, their grids spread out into configurations
    comparison  every configuration once, with a run folder and a report each
    trials      many seeds, kept one by one, resumed:
                plan (which trials), identity (what each depends on), trial (one of them), execution (here, or on a
                Dask cluster), store (the folder)
    tables      what many trials leave: numbers (of one run), results (with increments), parameters (columns of the
                grid), table_file (Parquet), statistics (intervals), summary (one estimate per configuration and series)

See docs/studies.md.
"""
