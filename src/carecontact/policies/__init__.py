"""The policies that ship with the benchmark and what they share; they import the contract and nothing of the world."""
