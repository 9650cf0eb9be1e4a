"""Reader of CommonRoad scenarios."""
