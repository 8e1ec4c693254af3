"""Reproducible trials under simulated time, and the results of many trials."""
