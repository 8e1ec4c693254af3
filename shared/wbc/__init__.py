"""The whole-body controller as pure mathematics: no I/O, no clock, no message.

model → contacts, tasks → stack (A and b) → qp (active set) → projector (A†) → torque.
Symbols are those of the paper; `docs/maths.md` defines each with its name, shape and unit.
"""
