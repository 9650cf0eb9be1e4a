"""Reader of the KITTI tracking benchmark."""
