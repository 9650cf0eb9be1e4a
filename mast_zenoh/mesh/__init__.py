"""Hosts nodes: one host for all of them, and a runtime for each way to run it.

host         one node, without I/O: checks, holds, counts, numbers and delays its messages
waiting      items that wait until they are due, and limits on the number and size of waiting messages
inproc       all nodes in one process
player       nodes that send what was recorded
protocol/    what the processes of a run do, as state machines without I/O
protocol_log what such a state machine was given and has asked for, and its replay
zenoh_process   one node on a Zenoh mesh: what its protocol asks for and what arrives; the only part with threads
hosting      builds a node's process from a resolved scenario, and ends it with the launcher; ends what the code of a
             node has started, and would outlive it
session      Zenoh sessions with our settings
control/     control messages: schemas and validation;  security/  certificates, rights, signing keys
file_client  transfers the files of a node on a host without the run folder
"""
