"""Runs a node as a process: `python -m mast_zenoh.runtime nodes/agent.py …`."""

from mast_zenoh.runtime.mesh.main import main

main()
