"""Where a policy runs and how it is spoken to: its process, wire and import wall, and serving it to other hosts."""
