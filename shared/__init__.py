"""What both ends of the link must agree on: robots, mathematics, wire format, clocks, buses."""
