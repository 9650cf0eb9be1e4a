"""Reader of Argoverse 2 logs."""
