"""The wires of other projects: what their clients send and what their servers answer, decoded defensively."""
