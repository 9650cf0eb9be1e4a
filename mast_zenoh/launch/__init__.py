"""Starts, watches and stops the processes of a run.

run           one run and its folder: on a mesh, or in this process
twin          the same run without its adversaries
mesh_run      the run on a mesh, from the first process to the last;  context: what its parts share
local_mesh    joins the mesh of nodes on this machine;  watch: the loop while nodes run;  mesh_conclusion: its end
supervisor    starts, watches and ends nodes;  processes: as processes of this machine
engine        base class of what starts nodes elsewhere;  file_server: their files
steps         what the scenario does to processes, when the driver requests it
interception  inserts nodes into wires of a running run
netns         the hosts of a run as network namespaces
reports       what nodes report: failures of handlers, results
latency       what was measured on the wall clock
conclusion    what is written at the end;  notices: what deserves attention
ending        how an ending becomes a status and an exit code;  liveness: whether a launcher lives
folder        what a run leaves behind;  tables: columns as Parquet;  nodelogs: logs of nodes in this process
display       what is shown meanwhile
measurement   a run measured again, from its recording
stop_signals  Ctrl-C, SIGTERM and SIGHUP
"""
