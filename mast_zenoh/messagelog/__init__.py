"""Recordings of a run's messages: messages.mcap, the bytes that were sent, by key.

channels    one channel per key, with a schema of its messages for other readers
chunks      unpacks a chunk of the file, within limits
writer      writes messages in whole chunks
reader      reads the messages in the order (frame, time, wire, publisher, sequence), also from a file that was cut off
difference  compares two such streams;  explain  describes the difference
events      changes of a run's wiring and members, recorded next to its messages
missing     why a folder has no recording, and the command that makes one
completeness  the first frame that a recording lacks
churn       nodes that were lost: from which frame on a recording is incomplete, or cannot be compared
"""
