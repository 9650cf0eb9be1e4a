"""Attacks on a run in progress at each security level, and their effects.

An outsider has network access; an insider also has one node's certificate and key.

attempts        attacks by an outsider: classes for a scenario file's `outsider()`
sybil           an outsider that invents agents
insiders        attacks by a compromised node: classes for a scenario file's `insiders()`
attacked_run    a run that plays while attackers act
infiltration    a run with an insider, compared with its undisturbed twin
position        what a compromised node knows about its run
forgeries       control messages that it sends
valid_messages  valid messages, from which forgeries are made
malformed       messages that every decoder rejects
falsehoods      messages that are well formed but untrue
sending         sends forged messages
detour          redirects one node's connection to the router
comparison      the same at every level of security
"""
