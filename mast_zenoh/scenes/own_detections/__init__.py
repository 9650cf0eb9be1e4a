"""Detections of a user's own detector, for any scene, in three file formats."""
