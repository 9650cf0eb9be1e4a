"""One node as a process on a Zenoh mesh, and the node that drives the scene.

node       a node's process, of: inbox (events for its main thread), intake (samples; early: of epochs to come),
           outlets (publishers), arrivals (when messages came), results_client (hands in the results)
driver     the node that decides when the next frame begins, with: membership (which nodes take part),
           newest (the newest value of each node), scene_frames (frames made ahead)
wiring_coordinator   how the wiring changes while a run goes on: the driver's part;  wiring_follower: each node's part
drain      whether a node has passed on all that it got
stamp      what data messages carry beside their payload
session    Zenoh sessions with our settings
hosting    from a resolved scenario to a node's process;  main: its `main`
launcher_watch  whether the launcher is there

Control messages lie under mast/{run}/@control/, a verbatim chunk, which no wildcard matches: see mast_zenoh.control.
"""
