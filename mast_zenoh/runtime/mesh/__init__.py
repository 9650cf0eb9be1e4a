"""One node as a process on a Zenoh mesh, and the node that drives the scene."""
