"""Inserts nodes into wires of a running run: a client and the launcher's server."""
