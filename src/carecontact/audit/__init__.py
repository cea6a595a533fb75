"""Tests whether anything that a policy is sent depends on what it must not know."""
