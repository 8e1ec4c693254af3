"""The parts that processes share: entry, command line, a service's log, real time."""
