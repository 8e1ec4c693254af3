"""What every process has: its entry, its command line, its service's log, real time."""
