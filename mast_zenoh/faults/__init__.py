"""Faults as a user writes them on one timeline, and what they mean for links, processes and the host network."""
