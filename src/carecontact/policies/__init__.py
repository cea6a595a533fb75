"""The shipped policies, and the motion that they share; they know the interface and nothing of the world."""
