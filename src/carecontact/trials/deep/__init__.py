"""What `carecontact check` looks at before a long run with a policy that somebody else serves."""
