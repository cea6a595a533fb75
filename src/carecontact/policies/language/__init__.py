"""From an instruction to an intent, and from an intent to one of several options: rules or a language model."""

LANGUAGE_VARIABLE, RECORD_VARIABLE = "CARECONTACT_LANGUAGE", "CARECONTACT_LANGUAGE_RECORD"
"""What a run's --language and --record reach a policy's process by."""
