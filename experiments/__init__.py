"""Reproducible runs under simulated time, and what is made of many of them."""
