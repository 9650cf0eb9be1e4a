"""One node as a process on a Zenoh mesh, and the node that drives the scene.

node       a node's process, with: inbox (events for its main thread), intake (samples; early: of later epochs),
           outlets (publishers), arrivals (arrival times), results_client (hands in the results)
driver     the node that decides when the next frame begins, with: membership (the participating nodes),
           newest (the newest value of each node), scene_frames (frames prepared in advance)
wiring_coordinator   changes the wiring of a running mesh: the driver's part;  wiring_follower: each node's part
drain      whether a node has forwarded everything that it received
stamp      the attachment of data messages
session    Zenoh sessions with our settings
hosting    builds a node's process from a resolved scenario;  main: its `main`
launcher_watch  whether the launcher is present

Control messages are below mast/{run}/@control/, a verbatim chunk, which no wildcard matches: see mast_zenoh.control.
"""
