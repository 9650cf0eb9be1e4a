"""Geometry, states, matching and neighbourhoods: functions on arrays without knowledge of the testbed."""
