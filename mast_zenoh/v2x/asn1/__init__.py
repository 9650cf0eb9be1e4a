"""Bytes of V2X messages: ASN.1 field tables, and unaligned packed encoding rules (UPER, ITU-T X.691).

asn1_types                kinds of types; the field tables are written with them
cdd, cdd_awareness        field tables of the common data dictionary, TS 102 894-2 v2.4.1
cpm_fields, cam_fields    field tables of TS 103 324 v2.1.1 and TS 103 900 v2.3.1
layout                    field tables as programs for the codec, and the place of each field in flat values
codec_kernels             the compiled codec: what it takes, returns and refuses
uper                      flat values to bytes and back
plain                     flat values as dicts and lists, for people and export
"""
