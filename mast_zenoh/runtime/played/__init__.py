"""Stand-ins for nodes of a recorded run: they send again what was recorded."""
