"""Makes an intent of an instruction, and chooses one of several options for an intent: by rules or a language model."""
