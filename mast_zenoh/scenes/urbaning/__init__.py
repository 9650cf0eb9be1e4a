"""Reader of UrbanIng-V2X."""
