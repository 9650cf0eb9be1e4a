"""One node as a process on a Zenoh mesh, and the node that drives the scene.

node       a node's process;  inbox: what waits for its main thread;  stamp: what its messages carry
driver     the process that decides when the next frame begins
rewiring   how the wiring changes while a run goes on
session    Zenoh sessions with our settings
hosting    from a resolved scenario to a node's process;  main: its `main`
launcher_watch  whether the launcher is there
"""
