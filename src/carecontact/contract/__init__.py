"""Pure data that every layer shares: what a policy sees, what it answers, what a trial is."""
