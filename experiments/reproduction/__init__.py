"""The paper's tables and figures made anew, beside the numbers that it prints."""
