"""Checks of whether the simulated person is physically valid: one check a file, and ``run`` runs them all."""
