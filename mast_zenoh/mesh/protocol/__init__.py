"""What the processes of a run do, as state machines: events in, actions out; no Zenoh, no thread, no clock, no file.

node       a node's process
driver     the node that decides when the next frame begins
pacer      which nodes take part, and whether the mesh is quiet; the process steps of a run by frame
rewiring   changes of the wiring: the driver's part, and each node's
traffic    the inbox, messages by epoch, what a node publishes, and the stamp of data messages
events     what they handle; what they ask for: carried out by runtime.mesh.zenoh_process, or by testing.simulation

A message: zenoh_process → node.receive_message → inbox → node.handle → Receiving.receive → host.deliver → handler.
"""
