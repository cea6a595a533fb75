"""From an instruction to an intent, and from an intent to one of several options: rules or a language model."""
