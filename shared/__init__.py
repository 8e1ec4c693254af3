"""The code that both ends of the link share: robots, mathematics, wire format, clocks, buses."""
