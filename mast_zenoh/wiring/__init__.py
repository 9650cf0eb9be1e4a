"""Key-expression maps, rewrites, and publishers and subscribers of every key."""
