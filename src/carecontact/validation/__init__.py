"""Checks whether the simulated person is physically valid: one check a file; ``carecontact.validation.run`` runs
them."""
