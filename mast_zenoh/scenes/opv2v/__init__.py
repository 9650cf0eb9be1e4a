"""Readers of OPV2V and the data sets that share its layout: V2XSet, V2X-Real, Multi-V2X, V2V4Real."""
