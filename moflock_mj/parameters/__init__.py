"""Parameter points of policies: named points, files and bounds."""
