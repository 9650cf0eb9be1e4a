"""Publishers and subscribers of every key: maps, rewrites, and the resulting model. Pure functions."""
