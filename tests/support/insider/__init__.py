"""A compromised node: it has the certificate and the key of its role, and forges control messages.

position      what it knows about its run, and valid control messages
forgeries     forged control messages of every kind, and their sending
infiltration  a run in which it acts, compared with its undisturbed twin
"""
