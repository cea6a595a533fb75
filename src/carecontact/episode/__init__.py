"""A trial without a policy: takes actions, gives observations and a recording."""
