"""A node as a process: `python -m mast_zenoh.runtime nodes/agent.py --run-folder DIR …`; see mesh/main.py."""

from mast_zenoh.runtime.mesh.main import main

main()
