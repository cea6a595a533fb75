"""One trial as a simulator sees it: what the seed decides, what the policy is shown, what is recorded."""
