"""A stack in the background: its registry, its state, its control socket."""
