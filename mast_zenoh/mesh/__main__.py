"""Runs a node as a process: `python -m mast_zenoh.mesh nodes/agent.py …`."""

import gc

gc.disable()  # until the node is hosted: what is imported stays, and searching it for garbage delays the start

from mast_zenoh.mesh.hosting import main  # noqa: E402

main()
