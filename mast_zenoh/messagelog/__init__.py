"""The messages of a run as a file, messages.mcap: the bytes that were sent, by key. docs/recording.md says it all.

channels    one channel per key; what the fields of its messages are, for other readers
writer      messages in, whole chunks out
reader      the messages in the order (frame, wire, publisher, sequence), as far as the file goes
difference  where two such streams differ;  explain  the same in words
churn       nodes that were lost: from which frame on a recording is not complete, or cannot be compared
"""
