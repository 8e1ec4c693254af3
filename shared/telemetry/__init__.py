"""Rows of measurements: their columns, their way out of a loop, and figures from them."""
