"""What an attacker without a role in a run achieves at each security level.

attempts      attacks by an outsider: classes for a scenario file's `outsider()`
attacked_run  a run that plays while an outsider acts
comparison    the same attempts at every level of security, and their table
"""
