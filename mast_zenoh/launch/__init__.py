"""Starts, watches and stops the processes of a run.

run           one run and its folder: on a mesh, or in this process
twin          the same run without its adversaries
mesh_run      the run on a mesh, from the first process to the last;  context: the state its parts share
local_mesh    joins the mesh of nodes on this machine;  watch: the loop while nodes run;  mesh_conclusion: its end
protocol      what the launcher decides, without I/O;  mesh_actions: carries it out on the mesh
supervisor    starts, watches and ends nodes;  processes: as processes of this machine
              forking: through the fork server, which has imported what nodes need
engine        base class of deployment engines;  file_server: files for their nodes
steps         process steps of the scenario, carried out when the driver requests them
blocking_clients  disconnects foreign clients that hold up a lock-step run
interception  inserts nodes into wires while a run plays
netns         the hosts of a run as network namespaces
reports       what nodes report: failures of handlers, results
latency       latencies on the wall clock
conclusion    writes the results at the end;  notices: what deserves attention; idle: what took no part
ending        maps endings to a status and an exit code;  liveness: whether a launcher is alive
folder        the run folder;  tables: columns as Parquet;  nodelogs: logs of nodes in this process
new_files     files and folders that are complete, or not there at all
log_reading   reads the logs of a run's nodes
display       progress on the console, from observation: activity of the nodes, newest_score
description   describes a running run to observers
measurement   measures a run again from its recording, with recorded_results: those of one node
stop_signals  Ctrl-C, SIGTERM and SIGHUP
"""
