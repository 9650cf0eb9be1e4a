"""Recordings of a run's messages: messages.mcap, the bytes that were sent, by key.

format      one channel per key, with a schema of its messages for other readers; changes of wiring and members
writer      writes messages in whole chunks
reader      reads the messages in the order (time, frame, wire, publisher, sequence), also from a file that was cut off
difference  compares two such streams, and describes the difference
script      what each node of a recorded run sent, to be sent again
churn       nodes that were lost: from which frame on a recording is incomplete, or cannot be compared
"""
