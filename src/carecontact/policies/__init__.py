"""Policies and the process boundary they live behind. Imports the contract and nothing of the world."""
