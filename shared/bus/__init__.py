"""Transport of bytes between nodes: an interface, an in-process bus for lockstep, and Zenoh."""
