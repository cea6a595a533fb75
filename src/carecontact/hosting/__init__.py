"""The place where a policy runs, and how trials reach it: its process, wire and import wall, and servers for other
hosts."""
