"""The LLM-augmented state machine: one look, one choice, one open-loop plan."""
