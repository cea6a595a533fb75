"""Tests whether anything sent to a policy depends on what it must not know. There are six parts, and each can fail."""
