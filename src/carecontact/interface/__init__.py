"""What a policy and the benchmark exchange, and what a policy may know of the body: actions, observations, cards, the
robot, regions; pure data."""
