"""Who publishes and who subscribes to which key: maps, rewrites, and the resulting model. Pure functions."""
