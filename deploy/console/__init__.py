"""A run in lines on a terminal."""
