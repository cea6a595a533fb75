"""The checks of `carecontact check` before a long run with a policy that somebody else serves."""
