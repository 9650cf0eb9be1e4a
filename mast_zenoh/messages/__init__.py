"""Data messages: schemas, codec, memory layout of their columns, and validation.

schemas     our message types;  definition  what the definition of one must be;  user_types  those of users
codec       encodes and decodes;  layout  dtypes, shapes and limits;  validation  explains what is wrong
timespan    the frames and times that messages of a run can have
"""

from mast_zenoh.messages.schemas import Column, Schema, text

__all__ = ["Column", "Schema", "text"]
