"""Checks of whether the simulated person is physically valid, with one file for each check; ``run`` runs them all."""
