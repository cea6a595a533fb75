"""Is the simulated person physically valid? One check a file; ``carecontact.validation.run`` runs them."""
