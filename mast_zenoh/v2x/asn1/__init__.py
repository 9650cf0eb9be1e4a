"""Bytes of V2X messages: ASN.1 field tables, and unaligned packed encoding rules (UPER, ITU-T X.691).

asn1_types                kinds of types; the field tables are written with them
cdd                       field tables of the common data dictionary, TS 102 894-2 v2.4.1
layout                    field tables as programs for the codec, and the place of each field in flat values
uper                      flat values to bytes and back; the compiled codec: what it takes, returns and refuses; flat
                          values as dicts and lists, for people and export
"""
