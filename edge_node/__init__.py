"""The edge: solves the full QP at each state that arrives and publishes its projector."""
