"""What attackers try against a run that is under way, at each level of security, and what comes of it.

An outsider has the network; an insider has one node's certificate and key.

attempts      what an outsider can try: classes that a scenario file names in its `outsider()`
insiders      what a compromised node can try: classes that it names in its `insiders()`
siege         a run that goes on while it is tried
infiltration  a run with an insider, compared with its undisturbed twin
position      what a compromised node knows of its run
forgeries     the control messages that it sends, of which
malformed     no decoder takes these, and
falsehoods    these are sound, and not true
sending       sends them
detour        the way of one node to the router, in the outsider's hands
comparison    the same at every level of security
"""
