"""Reproduction of the paper's tables and figures, beside the numbers that the paper prints."""
