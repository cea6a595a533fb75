"""Pure data shared by every layer: what a policy sees, what it answers, what a trial is. numpy and pydantic only."""
