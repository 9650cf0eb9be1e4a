"""Data messages: schemas, codec, memory layout of their columns, and validation."""
