"""What the launcher decides about a run on a mesh; no Zenoh, no thread, no clock, no file.

state         what is known of the run, and the request to stop it
endings       what the end of a process means for the run, and when a run that stops is over
steps         the process steps of the scenario
interception  nodes inserted into wires of the running run, and released
actions       what they ask for: carried out by launch.mesh_actions, or by testing.simulation

A supervisor starts and ends the processes: see launch.supervisor.
"""
