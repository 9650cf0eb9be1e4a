"""What the processes of a run do, as state machines: events in, actions out; no Zenoh, no thread, no clock, no file.

node       a node's process, with: receiving (messages by epoch), outlets (what it publishes),
           wiring_follower (its part in a change of the wiring)
driver     the node that decides when the next frame begins, with: membership (the participating nodes),
           pacer (whether the mesh is quiet), timetable (process steps), rewiring (changes of the wiring),
           scene_frames (frames prepared in advance)
actions    what they ask for: carried out by runtime.mesh.zenoh_process, or by testing.simulation
inbox      events that wait;  stamp: the attachment of data messages

A message: zenoh_process → node.receive_message → inbox → node.handle → receiving.receive → host.deliver → handler.
"""
