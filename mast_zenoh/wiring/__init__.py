"""Publishers and subscribers of every key: maps, rewrites, the resulting model.

Pure functions.
"""
