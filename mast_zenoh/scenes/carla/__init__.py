"""Reader of the CARLA multi-agent layout of AVstack."""
