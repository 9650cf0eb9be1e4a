"""Reader of TUMTraf-V2X, in OpenLABEL."""
