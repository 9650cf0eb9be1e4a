"""Generated junctions: streets, signals, traffic and buildings."""
