"""Zenoh's documented access control, evaluated on an `access_control` dict."""

from __future__ import annotations

from functools import cache
from typing import Any

import zenoh

includes = cache(lambda allowed, key: zenoh.KeyExpr(allowed).includes(zenoh.KeyExpr(key)))


def allows(access: dict[str, Any], common_name: str, flow: str, message: str, key: str) -> bool:
    """Whether a key expression is permitted: one rule must include all of it."""
    assert access["enabled"]
    assert access["default_permission"] == "deny"
    subjects = {s["id"] for s in access["subjects"] if common_name in s["cert_common_names"]}
    ids = {rule for policy in access["policies"] if subjects & set(policy["subjects"]) for rule in policy["rules"]}
    return any(
        includes(allowed, key)
        for rule in access["rules"]
        if rule["id"] in ids and rule["permission"] == "allow" and flow in rule["flows"] and message in rule["messages"]
        for allowed in rule["key_exprs"]
    )
