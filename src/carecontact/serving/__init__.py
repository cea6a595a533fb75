"""Where a policy runs and how it is spoken to: its process, sandbox and import wall, the wire, and other projects'
dialects."""
