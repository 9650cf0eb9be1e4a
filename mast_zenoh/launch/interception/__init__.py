"""Inserting nodes into wires of a running run: the client asks, the launcher (server) does it."""
