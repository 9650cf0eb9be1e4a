"""Standard V2X messages: CAM and CPM as wire formats.

asn1_types                      kinds of ASN.1 types; the field tables are written with them
cdd, cdd_awareness              field tables of the common data dictionary, TS 102 894-2 v2.4.1
cpm_fields, cam_fields          field tables of TS 103 324 v2.1.1 and TS 103 900 v2.3.1
layout                          field tables as programs for the codec, and the place of each field in flat values
codec_kernels                   references of the compiled codec
uper                            flat values to bytes and back: unaligned packed encoding rules, ITU-T X.691
plain                           flat values as dicts and lists, for people and export
    perceived_objects               objects of a CPM as columns of integers
    correlations                    correlations of their components, as a table
    cpm, cam                        messages as such columns and integers, in the standard's units
    reference_position              reference positions, and the plane around an origin
    tracks                          tracks to CPM and back, in as many segments as a limit of bytes needs
"""
