"""Data messages: schemas, codec, memory layout of their columns, and limits.

schemas     what a message type is, and ours;  user_types  those of users
codec       encodes, decodes and checks;  layout  dtypes, shapes and limits of columns
limits      rows, frames and times that messages of a run can have
"""

from mast_zenoh.messages.schemas import Column, Schema, text

__all__ = ["Column", "Schema", "text"]
