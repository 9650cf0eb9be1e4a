"""Readers of V2X-Seq-SPD, DAIR-V2X-C and RCooper."""
