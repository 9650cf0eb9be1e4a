"""Starts, watches and stops the processes of a run.

run           one run and its folder: on a mesh, or in this process
twin          the same run without its adversaries
mesh_run      the run on a mesh: its loop, what it carries out, and its end
context       the state that its parts share;  local_mesh: joins the mesh of nodes on this machine
launcher_protocol  what the launcher decides, without I/O: its loop;  progress: of nodes that are to finish
live_interception  inserts nodes into wires while a run plays: the request and its server
supervisor    starts, watches and ends nodes;  processes: as processes of this machine
              fork_server: the process that forks them, which has imported what nodes need
engine        base class of deployment engines;  file_server: files for their nodes
netns         the hosts of a run as network namespaces
reports       what nodes report: failures of handlers, results
conclusion    writes the results at the end, and the scene of driven cars;  notices: what deserves attention
ending        maps endings to a status and an exit code;  liveness: whether the launcher of a run.json is alive
log_reading   the logs of a run's nodes;  table_files: the tables that nodes hand in part by part
display       progress on the console;  observation: what it shows, measured on the wires
measurement   measures a run again from its recording
replay/       puts a recorded run back on a mesh: recorded nodes before a cut, live nodes after it
checks/       invariants of finished runs
stop_signals  Ctrl-C, SIGTERM and SIGHUP
"""
