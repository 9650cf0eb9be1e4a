"""Studies: many runs, compared.

    definition  study files, checked, their grids spread out into configurations
    comparison  every configuration once, with a run folder and a report each
    trials      many seeds, kept one by one, resumed, summed up:
                plan (which trials), identity (what each depends on), trial (one of them), execution (here, or on a
                Dask cluster), store (the folder), results and statistics (the tables)

See docs/studies.md.
"""
