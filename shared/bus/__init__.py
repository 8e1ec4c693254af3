"""Bytes from one node to another: a protocol, an in-process bus for lockstep, and Zenoh."""
