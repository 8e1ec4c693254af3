"""Print a run as lines on a terminal."""
