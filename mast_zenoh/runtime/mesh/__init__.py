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

Control traffic lies under mast/{run}/@control/, a verbatim chunk, which no wildcard matches:

    epoch            driver → all      the nodes that take part from now on; counters start anew
    counts/{node}    node → driver     messages sent and handled by key, whenever the inbox is empty
    failed/{node}    node → launcher   a handler has failed: its process, and an entry of mast_zenoh.control.failures
    stop             driver, launcher → all   finish, hand in results, leave
    leave/{node}     launcher → node   the same, for one of them
    act              driver → launcher what the scenario does to processes before this frame
    result/{node}    node → launcher   a query: the results, acknowledged by the reply
    fetch/{node}     node → launcher   a query, and
    file/{node}      node → launcher   another: see mast_zenoh.runtime.file_client
    launcher         launcher          its liveliness token
    rewire           launcher → driver a query: see wiring_coordinator
    drain/{node}     node → node       a query: see drain

mast_zenoh.control has their schemas, and says which of them are signed. A malformed one is counted, logged once for
each key, and dropped.
"""
